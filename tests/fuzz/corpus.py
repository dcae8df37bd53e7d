"""Inputs that took a new way through the code, and the damage that is done to inputs."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from tests.ros.helpers import random_message

from armcell.ros import schema

MAX_KEPT = 2000
NUMBERS = (
    "nan", "inf", "-inf", "1e400", "1e308", "-1e308", "1e-320", "0", "-0.0", "-1", "1.5", "2", "65536",
    "99999999999999999999", "1_000", "0x10", "1e", "", "[]", "{}", "null", "true", "abc",
)  # fmt: skip
WORDS = (
    "", " ", "a" * 3000, "\x00", "é", "\u2028", "../../../etc/passwd", "/dev/zero", "package://no/where",
    "${9**9**9}", "$(find no)", "*", "&a", "<<", "~", "%s", "{0}", "-", "'", '"', "]", "}", "<a>", "&amp;",
)  # fmt: skip
TOKEN = re.compile(rb"[-+]?[0-9][0-9.eE+-]*|[A-Za-z_][A-Za-z0-9_./-]*|\"[^\"\n]*\"|\s+|.", re.DOTALL)
LENGTHS = (0, 1, 3, 65, 1 << 20, 2**31 - 1, 2**31, 2**32 - 1)


class Corpus:
    """What one target has learnt; everything is drawn from one seed."""

    def __init__(self, seed: int | str):
        self.rng = random.Random(seed)
        self.numbers = np.random.default_rng(self.rng.randrange(2**63))  # for messages
        self.kept: list[Any] = []

    def chance(self, probability: float) -> bool:
        return self.rng.random() < probability

    def pick(self, items):
        return items[self.rng.randrange(len(items))]

    def keep(self, item: Any) -> None:
        if len(self.kept) < MAX_KEPT:
            self.kept.append(item)
        else:
            self.kept[self.rng.randrange(MAX_KEPT)] = item

    def message(self, name: str) -> Any:
        return random_message(schema(), name, self.numbers)

    def damage_text(self, data: bytes, others: Sequence[bytes]) -> bytes:
        """One to three words or lines replaced, doubled, moved, left out, or taken from another input."""
        for _ in range(self.pick((1, 1, 1, 2, 3))):
            tokens = TOKEN.findall(data)
            if not tokens:
                break
            at, how = self.rng.randrange(len(tokens)), self.rng.randrange(9)
            if how < 3:  # numbers are where most trouble is
                numbers = [
                    i for i, t in enumerate(tokens) if t[:1].isdigit() or (t[:1] in b"+-" and len(t) > 1)
                ]
                at = self.pick(numbers) if numbers else at
                tokens[at] = self.pick(NUMBERS).encode()
            elif how == 3:
                tokens[at] = self.pick(WORDS).encode()
            elif how == 4:
                tokens[at] = self.pick(TOKEN.findall(self.pick(others)) or [b""])
            elif how == 5:
                tokens[at] = self.pick(tokens)
            elif how == 6:
                del tokens[at : at + self.rng.randint(1, 12)]
            else:
                lines = b"".join(tokens).splitlines(keepends=True)
                line = self.rng.randrange(len(lines))
                if how == 7:
                    del lines[line]
                else:
                    lines.insert(self.rng.randrange(len(lines) + 1), lines[line])
                tokens = lines
            data = b"".join(tokens)
        return data

    def damage(self, data: bytes) -> bytes:
        """One to three bytes flipped, cut, put in, made a length, or replaced; in rare cases cut short."""
        raw = bytearray(data)
        for _ in range(self.rng.randint(1, 3)):
            if not raw:
                break
            at = self.rng.randrange(len(raw))
            how = self.rng.randrange(6)
            if how == 0:
                raw[at] ^= 1 << self.rng.randrange(8)
            elif how == 1:
                del raw[at : at + self.rng.randint(1, 8)]
            elif how == 2:
                raw[at:at] = self.rng.randbytes(self.rng.randint(1, 8))
            elif how == 3:
                raw[at : at + 4] = struct.pack("<I", self.pick(LENGTHS))
            elif how == 4:
                raw[at] = self.rng.randrange(256)
            elif self.chance(0.2):
                del raw[at:]
        return bytes(raw)
