"""What held-out data say of the answer, and the answer in words."""
