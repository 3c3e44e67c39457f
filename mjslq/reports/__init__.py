"""Reports on results: tables, benchmarks, comparisons, the papers' numbers beside ours."""
