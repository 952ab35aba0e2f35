"""From measured data to the physical effect that the model lacks."""
