"""What goes wrong between a tracker and its host: on markers, stamps, packets and the line."""
