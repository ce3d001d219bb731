"""What tests share: benches, drawn films, copies of the workflow, faults to be found."""
