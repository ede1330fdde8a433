"""Light fields in metres: checkerboard corners, camera intrinsics, rectified views."""
