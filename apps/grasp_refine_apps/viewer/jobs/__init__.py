"""Commands on the state, and the long jobs behind them."""
