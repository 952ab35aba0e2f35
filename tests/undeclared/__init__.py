"""Diagnosis of recordings whose cause it was not told."""
