"""The faults on the command line, the same for every command that has them."""

from __future__ import annotations

import argparse

from drivers.options import checked, seed
from simulators.corruption import Faults, parse_gaps, parse_noise, parse_share


def add_fault_options(parser: argparse.ArgumentParser) -> None:
    """Adds --noise, --drop, --gaps and --seed."""
    add = parser.add_argument
    add(
        "--noise",
        type=checked(parse_noise),
        default=0.0,
        metavar="1mm",
        help="Gaussian, per coordinate",
    )
    add(
        "--drop",
        type=checked(parse_share),
        default=0.0,
        metavar="5%",
        help="samples missing, frame by frame",
    )
    add(
        "--gaps",
        type=checked(parse_gaps),
        metavar="20%:10-100",
        help="samples missing in bursts of so many frames",
    )
    add("--seed", type=checked(seed), default=0, help="of noise and missing samples (default: 0)")


def faults_of(options: argparse.Namespace) -> Faults:
    """The faults that parsed options ask for."""
    return Faults(options.noise, options.drop, options.gaps)
