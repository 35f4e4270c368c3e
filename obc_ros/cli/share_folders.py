# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Share folders of packages, in a sourced workspace and in a virtual environment."""

import os
from pathlib import Path
import sys

from obc_ros.core.text.errors import ObcError


def share_directory(package: str) -> Path:
    """
    Return the share folder of a package below a prefix of AMENT_PREFIX_PATH or the interpreter's.

    For obc_ros itself this is the source tree if the modules are imported from there (an editable
    installation, links of a workspace): it has the same layout, and changes take effect at once.
    """
    source = Path(__file__).resolve().parents[2]
    if package == 'obc_ros' and (source / 'package.xml').is_file():
        return source
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    for prefix in filter(None, prefixes):
        if (folder := Path(prefix) / 'share' / package).is_dir():
            return folder
    raise ObcError(f"package '{package}' is not installed in {sys.prefix} nor in a sourced "
                   'workspace; source its setup file, or install it into this environment')
