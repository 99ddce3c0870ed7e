"""How the physics is run: the same stages, resident in one launch a frame or coloured in one launch a colour."""
