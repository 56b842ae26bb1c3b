"""Where data sets keep the calibration of their images."""

from __future__ import annotations

import logging
import os
import re
from pathlib import Path

from airline.errors import AirLineError, InputError
from frontend.camera.calibration import Calibration, read_calibration, says_rectified

log = logging.getLogger(__name__)

_ANY = tuple(
    f"{stem}.{suffix}"
    for stem in ("calib", "calibration", "camera", "camera_info", "intrinsics", "ost")
    for suffix in ("yaml", "yml", "json", "txt")
) + ("camchain*.yaml", "*-camchain.yaml", "calibration_matrix.txt", "sensor.yaml")
_RIGHT = re.compile(r"(images?_)?(r|right)$")
_LAYOUTS = (  # name of the folder with the images, how far up from there to go, and what to look for
    (r".*", 0, _ANY),
    (r"data", 1, ("sensor.yaml",)),  # EuRoC: cam0/data
    (r"data", 3, ("dso/camchain.yaml", "calib_cam_to_cam.txt")),  # TUM VI: mav0/cam0/data; KITTI: DRIVE/image_00/data
    (r"image_\d", 1, ("calib.txt",)),  # KITTI's odometry
    (r"(images?_)?(l|left|r|right)", 1, _ANY),  # of a pair, in one file
    (r"cam\d", 1, ("camchain*.yaml", "*-camchain.yaml")),
    (r"colou?r", 1, ("intrinsic/intrinsic_color.txt",)),  # ScanNet
    (r"images?|rgb|colou?r|frames|cam0", 1, _ANY),  # of one camera: TUM, ICL-NUIM, ETH3D
)


def calibration_beside(images: Path) -> Path | None:
    """The calibration file of a folder with images, None where there is none that is known by its name and place."""
    folder = Path(os.path.abspath(images))  # noqa: PTH100  keeps links
    for name, up, patterns in _LAYOUTS:
        if re.fullmatch(name, folder.name) and up <= len(folder.parents):
            place = (folder, *folder.parents)[up]
            for pattern in patterns:
                found = sorted(path for path in place.glob(pattern) if path.is_file())
                if found:
                    return found[0]
    return None


def find_calibration(images: Path) -> Calibration | None:
    """The calibration that lies with the images of a folder; a warning, and None, where it makes no sense."""
    try:
        file = calibration_beside(images)
        found = None if file is None else read_calibration(file, images)
        own = file is not None and (images / file.name).is_file()
        if found is not None and found.number is None and not own and _RIGHT.match(images.name):
            return None  # of one camera, which may be the left one
        if found is not None and found.camera.distortion != "none" and says_rectified(images):
            raise InputError(f"'{file}' has a lens, and by their folder's name the images are rectified")
        return found
    except (AirLineError, OSError) as error:
        log.warning("going on without the calibration that lies with the images: %s", error)
        return None
