"""Prints the first or second command of the README, as a newcomer would copy it."""

import re
import sys
from pathlib import Path

text = (Path(__file__).parents[1] / "README.md").read_text()
blocks = re.findall(r"```sh\n(.*?)```", text, flags=re.DOTALL)
sys.stdout.write(blocks[int(sys.argv[1]) - 1])
