"""The verdict in words and tables."""
