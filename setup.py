"""Name, version, requirements and executables of the suite, for pip and for colcon."""

import os
import subprocess
import sys
from glob import glob
from pathlib import Path

from setuptools import Extension, find_packages, setup

PACKAGE = "beam_ros"

# OpenCV 4.11 is the last that takes NumPy 1.26; pip finds it when NumPy is held there.
RIG = ["opencv-python-headless>=4.6", "pyserial>=3.5"]

# The page of `beam view` (docs/decisions/0017-one-small-server.md).
VIEW = ["aiohttp>=3.9"]

# ROS 2 Jazzy as wheels, pinned: later versions under these names are another distribution. They exist for
# x86-64 Linux only; elsewhere, and where a ROS 2 is sourced, the machine's own is used.
WHEELS = 'platform_system == "Linux" and platform_machine == "x86_64" and python_version < "3.15"'
ROS = [*RIG, *VIEW, f"ros-rclpy[fastrtps]==7.1.6; {WHEELS}", f"ros-common-interfaces==5.3.6; {WHEELS}"]

# Machine code for loops over long records and for the tracker's sums; the results are the same without.
COMPILED = ["numba>=0.60"]

# The tracker's own steps as machine code, made of the same source where BEAM_COMPILE is 1: it needs a C compiler.
MYPYC = "mypy>=2.4,<3"
MACHINE_CODE = ["appearance", "association", "disc_model", "marker_state", "second_image", "spots", "tracker"]
IS_COMPILED = os.environ.get("BEAM_COMPILE") == "1"

# A cluster for order selection and large batches (`map_records(..., scheduler=...)`).
DASK = ["distributed>=2024.1"]

# Bags in an object store, by their URLs.
REMOTE = ["fsspec>=2024.2", "s3fs>=2024.2"]

# The table of a study as a Parquet file (`beam study`; `--csv` does without).
STUDY = ["pyarrow>=14"]

# Measurements of other programs: universal files, TDMS, and MATLAB files of version 7.3, which are HDF5. CSV, NPZ and
# older MATLAB files need none of these.
FILES = ["pyuff>=2.4", "npTDMS>=1.7", "h5py>=3.10"]

# setuptools 80 dropped the `develop` command that `colcon build --symlink-install` calls; from 70.1 on it makes
# wheels by itself, so that a package can be installed offline.
TEST = [
    "pytest>=8.2",
    "pytest-xdist>=3.4",
    "hypothesis>=6.100",
    "control>=0.10",
    "scikit-fem>=10",
    "colcon-common-extensions",
    "colcon-ros",
    "setuptools>=70.1,<80",
    *DASK,
    *STUDY,
    *FILES,
]

# Pages in a real browser (`make verify`); a Chromium must be installed, and is not brought along.
BROWSER = ["playwright>=1.44", "axe-playwright-python>=0.1.4"]

DEV = [
    "ruff>=0.17,<0.18",
    MYPYC,
    "import-linter>=2.5,<3",
    "cosmic-ray>=8.4,<9",
    "coverage>=7.13,<8",
    "build>=1.2",
    "twine>=6",
    "check-manifest>=0.50",
]

# `make docs`; the newest Sphinx for Python 3.10 is 8.1.
DOCS = ["sphinx>=8.1", "myst-parser>=4", "furo>=2024.8"]

EXECUTABLES = [
    "beam",
    "simulator",
    "hub_driver",
    "vision_tracker",
    "excitation_generator",
    "identifier",
    "live_identifier",
    "bag_recorder",
    "bag_player",
    "firmware_emulator",
]


def machine_code() -> list[Extension]:
    """Extension modules of the tracker; none where none are asked for, or nothing is built yet."""
    in_place, copied = {"develop", "editable_wheel"}, {"build", "build_ext", "bdist_wheel"}
    if not IS_COMPILED or not (in_place | copied) & set(sys.argv):
        return []
    if in_place & set(sys.argv):
        raise SystemExit(
            "BEAM_COMPILE is 1 for an installation that leaves the source in its place, where edits would have "
            "no effect; expected one that copies it: leave out -e, or --symlink-install"
        )
    try:
        from mypyc.build import mypycify
    except ImportError as error:
        raise SystemExit(
            f"BEAM_COMPILE is 1 and there is no mypyc ({error}); expected it beside setuptools: pip install '{MYPYC}'"
        ) from None
    # Arrays are plain objects to mypyc, whether NumPy and its types are installed or not.
    options = ["--config-file=", "--no-site-packages", "--ignore-missing-imports", "--follow-imports=silent"]
    modules = [f"{PACKAGE}/vision/tracking/{name}.py" for name in MACHINE_CODE]
    found: list[Extension] = mypycify(
        [*options, *modules], opt_level="3", debug_level="0", group_name=PACKAGE
    )
    return found


# colcon's scripts start with signals blocked, as those of the set-up do, and the suite lets them in; pip makes its
# own first lines.
BLOCKED = ["/usr/bin/env", "-S", "--block-signal=INT --block-signal=TERM"]
CAN_BLOCK = sys.platform == "linux" and not subprocess.call([*BLOCKED, "true"], stderr=subprocess.DEVNULL)

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Simulates, drives, films and identifies a flexible cantilever beam on a moving hub.",
    # colcon links this file into its build folder.
    long_description=Path(__file__).resolve().with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    author="beam_ros maintainers",
    maintainer="beam_ros maintainers",
    maintainer_email="maintainers@beam-ros.invalid",
    license="Apache-2.0",
    keywords=["system identification", "modal analysis", "flexible beam", "vibration", "vision", "ROS 2"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: OS Independent",
        "Programming Language :: Python :: 3",
        "Programming Language :: Python :: 3.10",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Programming Language :: Python :: 3.14",
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    python_requires=">=3.10",
    packages=find_packages(include=["beam_*"]),
    package_data={
        "": ["py.typed", "*.pyi"],
        "beam_ident": ["report/page.html", "report/page.css"],
        PACKAGE: [
            "config/*.yaml",
            "config/*.xml",
            "config/*.rules",
            "config/cameras/*.yaml",
            "config/viewers/*",
            "experiments/plans/*.yaml",
            "model_files/*.c",
            "view/page/*.*",
            "view/page/uplot/*.*",
        ],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", glob("launch/*.launch.py")),
        (
            f"share/{PACKAGE}/config",
            [path for path in glob(f"{PACKAGE}/config/*.*") if not path.endswith(".py")],
        ),
        (f"share/{PACKAGE}/config/cameras", glob(f"{PACKAGE}/config/cameras/*.yaml")),
        (f"share/{PACKAGE}/viewers", glob(f"{PACKAGE}/config/viewers/*")),
    ],
    ext_modules=machine_code(),
    setup_requires=[MYPYC] if IS_COMPILED else [],
    options={"build_scripts": {"executable": f"{' '.join(BLOCKED)} {sys.executable}"}} if CAN_BLOCK else {},
    zip_safe=False,
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "rosbags>=0.11,<0.12",
        "mcap>=1.1",
        "ruamel.yaml>=0.17.21",
        "tqdm>=4.60",
        "jinja2>=3.0",
        "matplotlib>=3.6",  # Ubuntu 24.04's
    ],
    extras_require={
        "rig": RIG,
        "view": VIEW,
        "ros": ROS,
        "test": TEST,
        "dask": DASK,
        "study": STUDY,
        "files": FILES,
        "compiled": COMPILED,
        "remote": REMOTE,
        "dev": DEV,
        "browser": BROWSER,
        "docs": DOCS,
    },
    entry_points={
        "console_scripts": [f"{name} = {PACKAGE}.process.executables:{name}" for name in EXECUTABLES]
    },
)
