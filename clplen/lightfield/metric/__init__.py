"""Light fields in metres: corners of checkerboards, intrinsics of a camera, rectified views."""
