# A sourced Jazzy with this package: docker build -t train_ato . && docker run --rm train_ato train-ato run demo
FROM ros:jazzy
RUN apt-get update && apt-get install -y --no-install-recommends python3-venv ros-jazzy-simulation-interfaces \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /work
COPY . /src
# The distribution's packages are older than setup.py asks for: pip brings them into a virtual environment that sees the
# installation's own rclpy; colcon, run by its Python, installs the package itself for `ros2 run` and `ros2 launch`.
RUN . /opt/ros/jazzy/setup.sh \
    && python3 -m venv --system-site-packages /opt/venv \
    && /opt/venv/bin/pip install --no-cache-dir '/src[view,plan,export]' \
    && /opt/venv/bin/pip uninstall --yes train_ato \
    && /opt/venv/bin/python -m colcon build --base-paths /src --install-base /opt/train_ato --merge-install
ENV PATH=/opt/venv/bin:$PATH
RUN sed -i 's|^exec|source /opt/train_ato/setup.bash --\nexec|' /ros_entrypoint.sh
CMD ["train-ato", "run", "demo"]
