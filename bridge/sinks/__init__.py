"""Where poses go: VR engines over OSC, recordings, the view."""
