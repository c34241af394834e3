"""Text for people: names that may have been meant, and small pages for notebooks."""
