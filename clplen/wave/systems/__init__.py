"""Elements and distances along one axis: a field comes in, the field behind the last part goes
out."""
