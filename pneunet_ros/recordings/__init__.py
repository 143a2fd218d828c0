"""MCAP recordings, videos and folders of images."""
