"""Commands of `mjslq` with much to them, a file for each group; `mjslq.cli` has the others and the program."""
