"""Tables from files: CSV, JSON and parquet, every row of them or a line that says which row is wrong."""
