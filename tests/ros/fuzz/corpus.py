"""Inputs that took a new way through the code, and the damage that is done to inputs."""

from __future__ import annotations

import random
import struct
from typing import Any

import numpy as np
from tests.ros.helpers import random_message

from armcell.ros import schema

MAX_KEPT = 2000
LENGTHS = (0, 1, 3, 65, 1 << 20, 2**31 - 1, 2**31, 2**32 - 1)


class Corpus:
    """What one target has learnt; everything is drawn from one seed."""

    def __init__(self, seed: int):
        self.rng = random.Random(seed)
        self.numbers = np.random.default_rng(seed)  # for messages
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
