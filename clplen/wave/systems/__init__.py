"""Elements and distances along an axis: a field comes in, the field behind them goes out."""
