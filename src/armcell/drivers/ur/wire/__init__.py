"""Universal Robots wire protocols: messages between a controller and its clients."""
