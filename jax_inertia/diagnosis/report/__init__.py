"""What is written and said of a diagnosis: report.json, report.html, figures, sentences."""
