"""From the `plant` section of a case, a URDF or equations, to the model: as declared, with its effects, sampled."""
