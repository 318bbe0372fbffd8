"""Whole files made wrong: bytes changed anywhere, values of a JSON tree that are others, lines of a TOML file that are others."""

import json
import math
from copy import deepcopy
from random import Random

ODD = (
    None, True, False, 0, 1, -1, 3, 0.5, math.nan, math.inf, -math.inf, 10**400, -1e308, 5e-324, "", "a", "nan", "../../x",
    "\x00", [], {}, [[]], [1.0, "a"], {"a": 1}, [[[1.0]]], [math.nan], [[1.0], [1.0, 2.0]],
)  # fmt: skip
BYTES = (b"nan", b"1e999", b",", b"\n", b"[", b"-", b"\x00", b"\xff", b'"', b"9" * 400)
LINES = (
    "nan", "inf", "-1", "[]", '"x"', "1e308", "true", "[[0, 1]]", "[[]]", "{a = 1}", "9" * 400, "1979-05-27", '"\\u0000"',
)  # fmt: skip
KEYS = ("x ", "low ", "run ", "values ", '"" ')


def spoilt_bytes(seed: bytes, random: Random) -> bytes:
    """Some bytes replaced, put in or taken away, and now and then the end cut off."""
    content = bytearray(seed)
    for _ in range(random.randint(1, 6)):
        at = random.randint(0, len(content))
        content[at : at + random.randint(0, 12)] = random.choice((*BYTES, random.randbytes(random.randint(0, 8))))
    return bytes(content[: random.randint(0, len(content))] if random.random() < 0.3 else content)


def spoilt_tree(seed: bytes, random: Random) -> bytes:
    """One to three values anywhere in a JSON tree replaced, taken away or doubled."""
    content = json.loads(seed)
    for _ in range(random.randint(1, 3)):
        node = content
        while keys := list(node) if isinstance(node, dict) else list(range(len(node))):
            key = random.choice(keys)
            if isinstance(node[key], dict | list) and node[key] and random.random() < 0.8:
                node = node[key]
                continue
            match random.randint(0, 3):
                case 0:
                    del node[key]
                case 1 if isinstance(node, list):
                    node.append(deepcopy(node[key]))
                case _:
                    node[key] = deepcopy(random.choice(ODD))
            break
    return json.dumps(content).encode()


def spoilt_lines(seed: bytes, random: Random) -> bytes:
    """One to three lines of a TOML file with other values or other keys, or in another place."""
    lines = seed.decode().splitlines()
    for _ in range(random.randint(1, 3)):
        at = random.randrange(len(lines))
        key = lines[at].split("=")[0] if "=" in lines[at] else random.choice(KEYS)
        lines[at] = f"{key}= {random.choice(LINES)}" if random.random() < 0.8 else random.choice(lines)
    return "\n".join(lines).encode()


def spoilt(seed: bytes, ending: str, random: Random) -> bytes:
    """In a way that suits the kind of file, or in its bytes."""
    if ending == ".json" and random.random() < 0.8:
        return spoilt_tree(seed, random)
    if ending == ".toml" and random.random() < 0.7:
        return spoilt_lines(seed, random)
    return spoilt_bytes(seed, random)
