"""Pictures of MuJoCo scenes: drawn off screen, from a fitted camera, with a target and a path."""
