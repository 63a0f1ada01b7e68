"""The thesis' table: its rows, the data and runs behind them, and their statistics."""
