"""Measured recordings from CSV, Parquet, JSON and MCAP files, as plain columns."""
