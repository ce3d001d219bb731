"""What a run of the workflow has done, is doing and will cost, for a person who watches."""
