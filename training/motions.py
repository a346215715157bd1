"""What kind of motion a capture shows, from its free description: to report errors by kind.

All nine kinds of the paper's test set (section 4.2) are among them; the others are what else the
captures of the CMU database and of HDM05 show most.
"""

from __future__ import annotations

import re

UNKNOWN = "unknown"
OTHER = "other"

# Kind, and the words or phrases that tell it; the first that is found counts, so the narrow kinds
# come before the wide ones, and what is done on the feet comes last.
_KINDS = (
    ("walking on uneven terrain", r"uneven"),
    ("climbing three steps", r"climb\w* (3|three) steps"),
    ("running jump", r"run(ning)? (jump|leap)\w*"),
    ("soccer kick", r"soccer (ball )?kick\w*|kick\w* (a |the )?soccer"),
    ("salsa dancing", r"salsa"),
    ("cartwheeling", r"cartwheel\w*"),
    ("golfing", r"golf\w*|putt(s|ing)?"),
    ("soccer", r"soccer"),
    ("basketball signals", r"basketball signals?"),
    ("basketball", r"basketball|dribbl\w*"),
    ("directing traffic", r"direct\w* traffic"),
    ("washing", r"wash\w*"),
    ("acrobatics", r"acrobat\w*|(back)?flips?|handstands?|somersaults?"),
    ("dancing", r"(break)?danc\w*|ballet|pirouettes?"),
    ("fighting", r"karate|kata|martial|punch\w*|strik(e|es|ing)|kick\w*|boxing|sword\w*"),
    ("jumping", r"jump\w*|leap\w*|hop(s|ped|ping)?"),
    ("climbing", r"climb\w*|stairs?|ladder"),
    ("running", r"run(s|ning)?|jog\w*|sprint\w*"),
    ("walking", r"walk\w*|strid\w*|stroll\w*|march(es|ed|ing)?"),
    ("mixed", r"mixed|script|various"),
)
_PATTERNS = tuple((kind, re.compile(rf"\b({words})\b")) for kind, words in _KINDS)


def category(motion: str) -> str:
    """The kind of motion of a description such as `run/jog, sudden stop`: running.

    Case, punctuation and underscores do not matter. `unknown` where nothing is described, `other`
    where no word is known.
    """
    text = " ".join(re.findall(r"[a-z0-9]+", motion.lower()))
    if text in ("", UNKNOWN):
        return UNKNOWN
    return next((kind for kind, pattern in _PATTERNS if pattern.search(text)), OTHER)
