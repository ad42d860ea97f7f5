"""Energy tables and pictures for people."""
