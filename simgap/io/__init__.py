"""Files in and out: tables, recordings, figures."""
