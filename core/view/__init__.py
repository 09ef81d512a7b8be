"""What the camera sees: primary samples, the surfaces of each pixel, and the shading points on them."""
