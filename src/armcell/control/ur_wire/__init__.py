"""What goes over the wire between a Universal Robots controller and its clients, for both ends."""
