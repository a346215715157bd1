"""What a person sees of the session, drawn by Open3D in a process of its own."""
