"""What is told about results: tables, benchmarks, comparisons, the papers' numbers beside ours."""
