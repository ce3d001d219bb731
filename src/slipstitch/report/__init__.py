"""The page that a person reads: physics checks, dataset, training, tables, cost."""
