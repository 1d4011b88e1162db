"""Building octrees, and extracting them from a field that can be queried."""
