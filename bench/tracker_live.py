"""The node `tracker` behind a camera over DDS: frame rate and latency of targets.

    python bench/tracker_live.py [--json] [--seconds N] [--rate N] [--size W H] [--transport NAME]

Two processes: the node, started here as a user would, and this one, which plays a camera (mono8,
1280 x 720 by default, with camera_info, reliable) and listens as a controller would. Images go
raw, then as jpeg. Every stamp sent must come back on `targets` exactly once; `measured_curvature`
has no stamp and is counted. The time is from the publication of an image to its targets received
here: how much of it is not the node's is measured in the same way with one that takes the same
images and answers with a constant message (`bare`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
import json
import os
from pathlib import Path
import struct
import sys
import time

import cv2
import numpy as np
from over_dds import bench_options, cpu_seconds, NAMESPACE, own_domain, running_node
from pneunet_ros import load_model
from pneunet_ros.core.share import share_path

sys.path.append(str(Path(__file__).resolve().parent.parent / 'test'))
from support.rendered_frames import REST_FRAMES, View

SIZE = (1280, 720)
FRAMES = REST_FRAMES + 40
JPEG_QUALITY = 95  # that of image_transport
WARM_UP = 2.0  # s at the beginning that are not counted
PATIENCE = 5.0  # s; what has not come so long after the last image is lost
TARGETS, POINT_BYTES = 23, 72  # size of the message `targets`
NODE = ['-m', 'pneunet_ros.nodes.tracker']
BARE_NODE = [__file__, '--bare-node']
TRANSPORTS = ('raw', 'compressed')
Stamp = tuple[int, int]


def message_type(transport: str):
    """Return the type of images, and their topic."""
    from sensor_msgs.msg import CompressedImage, Image

    if transport == 'raw':
        return Image, 'image_raw'
    return CompressedImage, 'image_raw/compressed'


def bare_node():
    """Make a node that answers every image with a message as large as `targets`."""
    from array import array

    import rclpy
    from sensor_msgs.msg import CameraInfo, PointCloud2

    node = rclpy.create_node('tracker')
    transport = node.declare_parameter('image_transport', 'raw').value
    targets = node.create_publisher(PointCloud2, 'targets', 10)
    cloud = PointCloud2(data=array('B', bytes(TARGETS * POINT_BYTES)), is_dense=True)

    def answer(message) -> None:
        cloud.header = message.header
        targets.publish(cloud)

    node.create_subscription(CameraInfo, 'camera_info', lambda message: None, 10)
    node.create_subscription(*message_type(transport), answer, 10)
    return node


class Film:
    """Serialized images of an arm that bends, and the camera_info to them; stamps are put in."""

    def __init__(self, view: View) -> None:
        from array import array

        from rclpy.serialization import serialize_message
        from sensor_msgs.msg import CameraInfo, CompressedImage, Image

        lens = view.lens
        self.info = serialize_message(
            CameraInfo(
                width=lens.width,
                height=lens.height,
                distortion_model=lens.model,
                d=list(lens.distortion),
                k=lens.matrix.ravel(),
            )
        )
        self.images: dict[str, list[bytes]] = {name: [] for name in TRANSPORTS}
        for image, _ in view:
            grey = image.grey()
            jpeg = cv2.imencode('.jpg', grey, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
            height, width = grey.shape
            raw = Image(width=width, height=height, step=width, encoding='mono8')
            raw.data = array('B', grey.tobytes())
            packed = CompressedImage(format='mono8; jpeg compressed mono8')
            packed.data = array('B', jpeg.tobytes())
            self.images['raw'].append(serialize_message(raw))
            self.images['compressed'].append(serialize_message(packed))

    def played(self, transport: str) -> Iterator[bytes]:
        """Yield images without end: the arm bends, and back again."""
        moving = self.images[transport][REST_FRAMES:]
        while True:
            yield from moving
            yield from moving[-2:0:-1]


def stamped(serialized: bytes, stamp: Stamp) -> bytes:
    """Put a stamp into a serialized message that begins with a header."""
    return serialized[:4] + struct.pack('<iI', *stamp) + serialized[12:]


class Camera:
    """Publishes images at a steady rate and notes what comes back, and when."""

    def __init__(self, film: Film, transport: str) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import CameraInfo, PointCloud2
        from std_msgs.msg import Float64MultiArray

        rclpy.init()
        self.film, self.transport = film, transport
        self.shown = film.played(transport)
        self.node = rclpy.create_node('camera', namespace=NAMESPACE)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.infos = self.node.create_publisher(CameraInfo, 'camera_info', 10)
        self.images = self.node.create_publisher(*message_type(transport), 10)
        self.node.create_subscription(PointCloud2, 'targets', self.take_targets, 10)
        self.node.create_subscription(
            Float64MultiArray, 'measured_curvature', self.take_curvature, 10
        )
        self.now = 1_000_000_000_000  # ns, anywhere but at 0
        self.sent: dict[Stamp, int] = {}
        self.came: list[tuple[Stamp, int, bool]] = []
        self.curvatures = 0

    def take_targets(self, message) -> None:
        now = time.perf_counter_ns()
        stamp = message.header.stamp
        self.came.append(((stamp.sec, stamp.nanosec), now, message.is_dense))

    def take_curvature(self, message) -> None:
        self.curvatures += 1

    def show(self, image: bytes, rate: float) -> None:
        """Publish camera_info and image."""
        self.now += round(1e9 / rate)
        stamp = divmod(self.now, 1_000_000_000)
        info, image = stamped(self.film.info, stamp), stamped(image, stamp)
        self.infos.publish(info)
        self.sent[stamp] = time.perf_counter_ns()
        self.images.publish(image)

    def connect(self, process, timeout: float = 240.0) -> None:
        """Show the arm at rest until the node answers, subscribed reliably."""
        from rclpy.qos import ReliabilityPolicy

        begin = time.monotonic()
        rest = self.film.images[self.transport][:REST_FRAMES]
        while True:
            for image in rest:
                self.show(image, 60.0)
                self.spin(0.05)
            found = self.node.get_subscriptions_info_by_topic(self.images.topic_name)
            qualities = [item.qos_profile.reliability for item in found]
            if qualities == [ReliabilityPolicy.RELIABLE] and sum(
                whole for _, _, whole in self.came
            ) > len(rest):
                return
            if process.poll() is not None or time.monotonic() - begin > timeout:
                raise SystemExit(f'no targets: {len(self.came)} messages came')

    def spin(self, seconds: float) -> None:
        """Listen for so long."""
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0.0:
            self.executor.spin_once(timeout_sec=left)

    def run(self, seconds: float, rate: float) -> float:
        """Publish at the rate and listen in between; then wait for the rest.

        Return how many images a second were published.
        """
        self.sent.clear()
        self.came.clear()
        self.curvatures = 0
        begin = time.perf_counter()
        for index in range(round(seconds * rate)):
            image = next(self.shown)
            due = begin + index / rate
            while (left := due - time.perf_counter()) > 0.0:
                self.executor.spin_once(timeout_sec=left)
            self.show(image, rate)
        took = time.perf_counter() - begin
        end = time.perf_counter() + PATIENCE
        while len(self.came) < len(self.sent) and time.perf_counter() < end:
            self.spin(0.1)
        self.spin(0.5)
        return (len(self.sent) - 1) / took

    def close(self) -> None:
        import rclpy

        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown()


def measure(
    what: list[str], film: Film, transport: str, seconds: float, rate: float
) -> dict[str, float]:
    """Run a node for so long with images of a transport."""
    with running_node([*what, '--ros-args', '-p', f'image_transport:={transport}']) as process:
        camera = Camera(film, transport)
        camera.connect(process)
        camera.run(WARM_UP, rate)
        cpu = cpu_seconds(process.pid)
        published = camera.run(seconds, rate)
        # Of the time of publication: waiting for what is lost would make the share look small.
        share = (cpu_seconds(process.pid) - cpu) * published / (len(camera.sent) - 1)
        camera.close()
    return verdict(camera) | {'rate_hz': published, 'cpu_percent': 100.0 * share}


def verdict(camera: Camera) -> dict[str, float]:
    """Sum up what came back."""
    times = Counter(stamp for stamp, _, _ in camera.came)
    latency = [
        1e-6 * (at - camera.sent[stamp]) for stamp, at, _ in camera.came if stamp in camera.sent
    ]
    p50, p99 = np.percentile(latency, [50, 99])
    return {
        'sent': len(camera.sent),
        'lost': len(camera.sent.keys() - times.keys()),
        'twice': sum(count - 1 for count in times.values()),
        'foreign': len(times.keys() - camera.sent.keys()),
        'whole': sum(whole for _, _, whole in camera.came),
        'curvatures': camera.curvatures,
        'p50_ms': float(p50),
        'p99_ms': float(p99),
        'max_ms': float(max(latency)),
    }


def main() -> int:
    parser = bench_options(__doc__.splitlines()[0], bare_node)
    parser.add_argument(
        '--seconds', type=float, default=20.0, help='duration of each run (default: 20)'
    )
    parser.add_argument('--rate', type=float, default=60.0, help='images per s (default: 60)')
    parser.add_argument(
        '--size', type=int, nargs=2, default=SIZE, help='of images, px (default: 1280 720)'
    )
    parser.add_argument('--transport', nargs='+', choices=TRANSPORTS, default=TRANSPORTS)
    options = parser.parse_args()
    arm = load_model(share_path('config/paper_arm.yaml'))
    film = Film(View(arm, 3, FRAMES, size=tuple(options.size), hidden=False))
    with own_domain():
        results = {
            transport: {
                name: measure(what, film, transport, options.seconds, options.rate)
                for name, what in (('bare', BARE_NODE), ('tracker', NODE))
            }
            for transport in options.transport
        }
    load = os.getloadavg()[0]
    if options.json:
        settings = {'rate_hz': options.rate, 'seconds': options.seconds, 'load': load}
        print(json.dumps({'bench': 'tracker_live', **settings, **results}))
        return 0
    for transport, result in results.items():
        print(f'{transport:12}{"tracker":>10}{"bare":>10}')
        for name in result['bare']:
            print(f'  {name:10}{result["tracker"][name]:10.4g}{result["bare"][name]:10.4g}')
    print(f'wanted: nothing lost; load of the machine meanwhile: {load:.2g}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
