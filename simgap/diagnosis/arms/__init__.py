"""Diagnosis of arms by inverse dynamics: measured torques against those that the measured motion asks for."""
