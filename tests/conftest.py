"""What all tests share: one BLAS thread, and the same hypothesis examples in every run."""

import os

# Before numpy is imported. On a machine that does something else as well, BLAS's threads wait for each other and the
# dense references of the tests take twenty times as long.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from hypothesis import HealthCheck, settings  # noqa: E402

settings.register_profile(
    "mjslq",
    deadline=None,  # the first call of a compiled kernel may take seconds
    derandomize=True,
    database=None,
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("mjslq")
