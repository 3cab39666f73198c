"""Installs train_ato: with colcon as an ament_python package, or with pip on a machine that has only Python."""

import os
import sys
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).resolve().parent  # colcon build --symlink-install runs a link to this file
NAME = "train_ato"
EXPORT = ["pyarrow>=23.0.1"]
"""Package of the tables in files."""
SWEEP = [*EXPORT, "distributed>=2026.1", "scipy>=1.15", "cryptography>=46.0.7"]
"""Packages of the command sweep."""
TUNE = ["cma>=3.3"]
"""Packages of the command tune."""
REPORT = ["bokeh>=3.9.2", "Jinja2>=3.1.6"]
VIEW = [*REPORT, "tornado>=6.5.5", "foxglove-sdk>=0.30"]
PLAN = ["scipy>=1.15"]
"""Package of the lower bound of the energy of a plan."""
PICTURES = ["pillow>=12.2"]
"""Package of the figures of the law pages."""
DOCS = ["sphinx>=8.1", "myst-parser>=4.0", "numpydoc>=1.8", "furo>=2024.8.6"]
"""Packages that build the site."""


def version() -> str:
    """Read the version from the one file that declares it."""
    scope: dict[str, str] = {}
    exec((HERE / NAME / "program" / "version.py").read_text(), scope)
    return scope["VERSION"]


def ros_wheels() -> list[str]:
    """Name the ROS wheels, unless a sourced ROS 2 installation already provides rclpy and the messages."""
    if os.environ.get("ROS_DISTRO") or os.environ.get("AMENT_PREFIX_PATH"):
        return []
    return ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"]


def examples(pattern: str) -> list[str]:
    """Name the templates of `train-ato new`, relative to this folder."""
    return sorted(str(path.relative_to(HERE)) for path in (HERE / "examples").glob(pattern))


def site() -> list[tuple[str, list[str]]]:
    """Name the files of the built site by their folder in an installation; none without a site."""
    folders: dict[str, list[str]] = {}
    for path in sorted(path.relative_to(HERE) for path in (HERE / "site").rglob("*") if path.is_file()):
        folders.setdefault(f"share/{NAME}/{path.parent.as_posix()}", []).append(str(path))
    return list(folders.items())


def shared(folder: str, pattern: str) -> tuple[str, list[str]]:
    """Name the files of a folder that ROS 2 reads from the share of the package."""
    return f"share/{NAME}/{folder}", sorted(str(path.relative_to(HERE)) for path in (HERE / folder).glob(pattern))


def on_path() -> list[tuple[str, list[str]]]:
    """Name the command for the path of a colcon workspace; pip has one of its own."""
    return [] if {"bdist_wheel", "editable_wheel"} & set(sys.argv) else [("bin", ["resource/bin/train-ato"])]


def launchers() -> list[str]:
    """Name the commands: the entry script and one for each node, for `ros2 run`."""
    nodes = ("plant", "supervisor", "profile", "observer", "controller", "recorder")
    module = "train_ato.cli.nodes"
    return ["train-ato = train_ato.cli:main", *(f"{node}_node = {module}:{node}" for node in nodes)]


setup(
    name=NAME,
    version=version(),
    description="Onboard automatic train operation as a ROS 2 node graph, with a train simulator",
    long_description=(HERE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    maintainer="The train_ato team",
    maintainer_email="train-ato@example.org",
    python_requires=">=3.10,<3.14",
    # An editable install then adds this folder to the path. The import hook it would use otherwise comes after a folder
    # of compiled kernels that an earlier installation has left, and the package would be found empty.
    package_dir={"": "."},
    packages=find_packages(include=["train_ato", "train_ato.*", "plant_sim", "plant_sim.*"]),
    package_data={
        "plant_sim": ["py.typed", "data/*/*.yaml", "data/*/*.csv"],
        "train_ato": [
            "py.typed", "control/*.yaml", "api/import_csv/layouts/*.yaml", "scenario/shipped/*",
            "scenario/shipped/following/*", "scenario/schemas/*.json", "ros/graph/*.xml", "report/page.*",
            "view/page.*", "view/*.js", "papers/*.md", "papers/*/*.yaml",
        ],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/examples", examples("my_*.py")),
        (f"share/{NAME}/examples/metro", examples("metro/*.yaml")),
        (f"share/{NAME}/examples/driver", examples("driver/*.yaml")),
        (f"share/{NAME}/examples/ros", examples("ros/*.py")),
        shared("launch", "*.launch.py"),
        shared("config", "*.yaml"),
        *site(),
        *on_path(),
    ],
    # Every bound is a version that exists, passes .ci/lowest and is above the published security holes.
    install_requires=[
        "numpy>=1.26",
        "numba>=0.60",
        "mcap>=1.2.1",
        "zstandard>=0.20",
        "rosbags>=0.11.9",
        "pydantic>=2.10",
        "PyYAML>=6.0.1",
        "rich>=15",
        "matplotlib>=3.8",
        "pandas>=2.1",
        "pebble>=5.0.7",
        "rainflow>=3.2",
        "argcomplete>=3.1",
        *ros_wheels(),
    ],
    extras_require={
        "report": REPORT,
        "export": EXPORT,
        "view": VIEW,
        "plan": PLAN,
        "sweep": SWEEP,
        "tune": TUNE,
        "docs": [*DOCS, *VIEW, *EXPORT, *PLAN, *PICTURES, *SWEEP, *TUNE],
        "gymnasium": ["gymnasium>=1.1"],
        "xarray": ["xarray>=2024.1"],
        "rerun": ["rerun-sdk>=0.24; python_version >= '3.11'"],
        "test": [
            *SWEEP,
            *VIEW,
            *PICTURES,
            *DOCS,
            *TUNE,
            "gymnasium>=1.1",
            "xarray>=2024.1",
            "control>=0.10",
            "rtamt>=0.3.5; python_version < '3.13'",
            "pytest>=8",
            "pytest-xdist>=3.5",
            "pytest-timeout>=2.3",
            "hypothesis>=6.100",
            "jsonschema>=4.20",
            "mutmut>=3.8,<4",
            "ros-domain-coordinator",
            "mcap-ros2-support>=0.5",
            "rerun-sdk>=0.24; python_version >= '3.11'",
            "ruff>=0.6",
            "mypy>=1.11",
            "types-PyYAML",
        ],
    },
    entry_points={"console_scripts": launchers()},
    zip_safe=False,
)  # fmt: skip
