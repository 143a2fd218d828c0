# The package on ROS 2 Jazzy, built as on a robot:
#   docker build -t pneunet .
#   docker run --rm -it --net=host pneunet ros2 launch pneunet_ros demo.launch.py
FROM ros:jazzy-ros-base

RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-colcon-common-extensions python3-pip \
    && rm -rf /var/lib/apt/lists/*
# rosdep brings some libraries by pip, which Ubuntu allows in a container alone.
ENV PIP_BREAK_SYSTEM_PACKAGES=1

WORKDIR /workspace
COPY package.xml src/pneunet_ros/
RUN apt-get update && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src -y --rosdistro jazzy \
    && rm -rf /var/lib/apt/lists/*

COPY . src/pneunet_ros
RUN . /opt/ros/jazzy/setup.sh && colcon build \
    && . install/setup.sh && install/pneunet_ros/lib/pneunet_ros/pneunet compile

# A devcontainer is started past the entrypoint: its terminals are shells of their own.
RUN echo '. /opt/ros/jazzy/setup.bash; . /workspace/install/setup.bash' >> /root/.bashrc
COPY .devcontainer/entrypoint.sh /entrypoint.sh
ENTRYPOINT ["/entrypoint.sh"]
CMD ["bash"]
