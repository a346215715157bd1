"""What a person sees of the session: bodies, floor and meter, drawn by Open3D in a child process."""
