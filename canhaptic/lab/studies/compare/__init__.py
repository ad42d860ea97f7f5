"""Every algorithm on one scene."""
