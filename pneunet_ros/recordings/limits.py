"""Size limits of recordings; sizes declared in a file are not trusted.

A recording that exceeds them is damaged, or designed to exhaust memory.
"""

LARGEST_CHUNK = 100_000_000  # bytes, also of a message: a raw image of 8K
LARGEST_DEFINITION = 1_000_000  # bytes of a topic or type: a hundred times the usual size
MOST_EXPANSION = 1_000  # sizes of the file, unpacked: black images are packed 1000 times
ALWAYS_UNPACKED = 100_000_000  # bytes that any file may have, unpacked
RECORDS_PER_BYTE = 1  # in chunks: a message with a log time of its own takes more than a byte
MOST_WAITING = 300_000_000  # bytes held at once to order messages, where chunks overlap in time
LONGEST_NAME = 255  # characters of a topic or type: rmw of ROS 2
