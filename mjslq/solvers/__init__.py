"""Methods: one a file, on parts that they share."""
