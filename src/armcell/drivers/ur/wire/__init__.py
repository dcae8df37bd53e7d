"""Wire protocols of Universal Robots: messages between a controller and its clients."""
