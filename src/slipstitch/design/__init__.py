"""What is to be made: grid, splits, frames, cost; decided before anything is made."""
