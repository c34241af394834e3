"""How sure an answer is: causes and stand-ins, what would do in their place, probabilities, the verdict."""
