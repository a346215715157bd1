"""From what was heard to all findings, and to the address that mends what can be mended."""

from __future__ import annotations

from bridge.doctor.body import body_findings
from bridge.doctor.finding import Finding, corrected
from bridge.doctor.heard import Heard, read_again
from bridge.doctor.line import line_findings
from bridge.model import ModelInfo

ROUNDS = 6  # of mending


def examine(heard: Heard, info: ModelInfo) -> tuple[list[Finding], str]:
    """All findings, the worst first, and the address with all their options.

    The bytes are read again under each correction, so one fault does not hide the next, and the
    address was tried on them.
    """
    mended: list[Finding] = []
    for _ in range(ROUNDS):
        findings = [*line_findings(heard), *body_findings(heard, info)]
        to_mend = [finding for finding in findings if finding.options]
        if not to_mend:
            break
        options = {name: value for finding in to_mend for name, value in finding.options.items()}
        address = corrected(heard.address, options)
        if address == heard.address or not heard.can_be_read_again:
            break
        mended += to_mend
        heard = read_again(heard, address)
    else:
        findings = [*line_findings(heard), *body_findings(heard, info)]
    return sorted([*mended, *findings], key=lambda finding: finding.grade), heard.address
