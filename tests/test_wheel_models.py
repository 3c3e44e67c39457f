"""Public models: each is taken, without a traceback, without a wrong derivative. `pytest -m slow -s` prints them."""

import pytest
from wheel_models import PACKAGES, VARIABLE, model_files, survey

pytestmark = pytest.mark.slow


def test_models_of_gymnasium_and_dm_control():
    files = model_files()
    if not files:
        pytest.skip(f"neither {' nor '.join(PACKAGES)} is installed, and {VARIABLE} names no folder with models")
    rows = []
    for path in files:
        rows.append(survey(path))
        print(rows[-1], flush=True)
    assert [str(row) for row in rows if row.traceback] == []
    assert [str(row) for row in rows if row.wrong] == []
    taken = [row for row in rows if row.served != "refused"]
    assert len(taken) >= 0.95 * len(rows)
