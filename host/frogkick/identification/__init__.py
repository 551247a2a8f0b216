"""What a model lacks, from logs: residuals, candidate effects, their fit and choice, a verdict."""
