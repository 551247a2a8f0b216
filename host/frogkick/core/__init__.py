"""What every room shares: errors, files, chunks of long work, progress, what is compiled."""
