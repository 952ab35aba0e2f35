"""Windows simulated under every candidate effect, with their sensitivities."""
