"""The larger commands of `mjslq`, a file for each group; the others are in `mjslq.cli`."""
