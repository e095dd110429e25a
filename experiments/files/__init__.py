"""What the file formats keep."""
