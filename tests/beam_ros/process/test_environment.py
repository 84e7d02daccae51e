from __future__ import annotations

from beam_ros.process import environment


def test_the_one_folder_that_may_stay_on_the_path_is_the_packages_own() -> None:
    assert (environment._PACKAGE_ROOT / "beam_ros" / "process" / "environment.py").samefile(
        environment.__file__
    )
