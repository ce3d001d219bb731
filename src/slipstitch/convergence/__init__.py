"""How far drop-and-drag depends on the time step and on the mesh."""
