"""The search for what a model lacks: ordinary physics of every joint, then odd effects by log evidence."""
