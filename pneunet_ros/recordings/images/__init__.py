"""Images of recordings, videos and folders."""
