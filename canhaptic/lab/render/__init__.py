"""Pictures, pages and tables of the studies."""
