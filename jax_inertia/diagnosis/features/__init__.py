"""What effects are computed from: quantities of one log along its motion, in the model's derivatives."""
