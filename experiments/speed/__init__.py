"""What the work costs, against other tools and against other ways."""
