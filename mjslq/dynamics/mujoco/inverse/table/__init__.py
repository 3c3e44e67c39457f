"""What the kernel is told about a model, and how it reads that: records, columns, offsets."""
