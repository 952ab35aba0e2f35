"""High-fidelity simulators behind one interface; each engine is a plug-in."""
