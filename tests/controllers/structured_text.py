"""A strict reader of the part of IEC 61131-3 Structured Text that exported laws use; it knows nothing of the export.

`FunctionBlock(text)` parses, checks and runs one FUNCTION_BLOCK. Refused (`STError`) is what a compiler for a PLC refuses, and
what one may take otherwise than meant: undeclared or unused variables, names that differ in case only, words of the language as
names, assignments to constants, inputs and loop variables, INT where LREAL stands or the other way round, a quotient of INTs,
literals of the wrong type or number, anything but plain ASCII. An index out of range ends the run. AND and OR compute both sides.
"""

import math
import re

TOKEN = re.compile(
    r"(?P<space>\s+|\(\*.*?\*\))|(?P<real>\d+\.\d+(?:E[+-]?\d+)?)|(?P<int>\d+(?![.\w])|\d+(?=\.\.))"
    r"|(?P<word>[A-Za-z_]\w*)|(?P<sign>:=|<=|>=|<>|\.\.|[-+*/<>=()\[\]:;,])",
    re.DOTALL | re.ASCII,
)
SECTIONS = {"VAR_INPUT": "input", "VAR_OUTPUT": "output", "VAR": "memory"}
TYPES = {"LREAL": 0.0, "INT": 0, "BOOL": False}
LEVELS = (("OR",), ("XOR",), ("AND",), ("=", "<>"), ("<", ">", "<=", ">="), ("+", "-"), ("*", "/"))
FUNCTIONS = {"EXP": (math.exp, 1), "EXPT": (math.pow, 2)}
OTHER_WORDS = (
    "FUNCTION_BLOCK END_FUNCTION_BLOCK END_VAR CONSTANT RETAIN ARRAY OF IF THEN ELSIF ELSE END_IF FOR TO BY DO END_FOR "
    "WHILE END_WHILE REPEAT UNTIL CASE AND OR XOR NOT MOD TRUE FALSE AT DT TIME DATE TOD REAL STRING LIMIT MIN MAX SEL MUX "
    "ABS SQRT LN LOG SIN COS TAN EXIT RETURN PROGRAM FUNCTION TYPE STRUCT ON ADD SUB MUL DIV EQ NE GE GT LE LT EN ENO TASK "
    "WITH STEP ACTION LEN LEFT RIGHT MID FIND MOVE "
)
WORDS = {*SECTIONS, *TYPES, *FUNCTIONS, *re.findall(r"\w+", OTHER_WORDS)}


class STError(Exception):
    """The text is not a function block that every compiler takes as it is meant."""


class Variable:
    """Declared once: its section, type and array bounds (none for a single one), and its first value."""

    def __init__(self, section, kind, bounds, value):
        self.section, self.kind, self.bounds, self.value, self.used = section, kind, bounds, value, False


class FunctionBlock:
    """`call(**inputs)` runs it once and returns its outputs; memory stays from call to call, as in a PLC."""

    def __init__(self, text):
        reader = _Reader(text)
        self.name, self.variables = reader.name, reader.variables
        self.values = {name: list(v.value) if v.bounds else v.value for name, v in self.variables.items()}
        names = {"V": self.values, "at": _offset, **{name: f for name, (f, _) in FUNCTIONS.items()}}
        exec(
            compile("\n".join(["def run():", *reader.lines, " return"]), self.name, "exec"), names
        )  # made above, of checked parts
        self._run = names["run"]

    def call(self, **inputs):
        assert {name for name, v in self.variables.items() if v.section == "input"} == set(inputs)
        for name, value in inputs.items():
            own = self.variables[name]
            assert not own.bounds or len(value) == len(own.value)
            self.values[name] = [float(x) for x in value] if own.bounds else type(own.value)(value)
        self._run()
        found = {name: self.values[name] for name, v in self.variables.items() if v.section == "output"}
        return {name: list(value) if isinstance(value, list) else value for name, value in found.items()}


def _offset(bounds, *index):
    """Where an element lies, the last index fastest."""
    at = 0
    for (low, high), i in zip(bounds, index, strict=True):
        if not low <= i <= high:
            raise STError(f"index {i} outside {low}..{high}")
        at = at * (high - low + 1) + i - low
    return at


class _Reader:
    """Recursive descent; every expression becomes (Python text, type)."""

    def __init__(self, text):
        if not text.isascii():
            raise STError("not plain ASCII")
        self.tokens, at = [], 0
        while at < len(text):
            found = TOKEN.match(text, at)
            if not found:
                raise STError(f"cannot read {text[at : at + 20]!r}")
            if found.lastgroup == "space" and found.group().startswith("(*") and "(*" in found.group()[2:]:
                raise STError("a comment in a comment")
            if found.lastgroup != "space":
                self.tokens.append((found.lastgroup, found.group()))
            at = found.end()
        self.at, self.variables, self.lines, self.loops = 0, {}, [], []
        self.expect("FUNCTION_BLOCK")
        self.name = self.word()
        while self.peek() in SECTIONS:
            self.section()
        if self.name in self.variables:
            raise STError(f"{self.name} is the block and a variable")
        self.statements("END_FUNCTION_BLOCK", depth=1)
        self.expect("END_FUNCTION_BLOCK")
        if self.at < len(self.tokens):
            raise STError(f"{self.peek()} after the block")
        if idle := [name for name, v in self.variables.items() if not v.used]:
            raise STError(f"never used: {', '.join(idle)}")

    # ---- tokens ------------------------------------------------------------------------------------------------------

    def peek(self):
        return self.tokens[self.at][1].upper() if self.at < len(self.tokens) else ""

    def take(self):
        self.at += 1
        return self.tokens[self.at - 1] if self.at <= len(self.tokens) else ("", "")

    def accept(self, text):
        if self.peek() == text:
            self.at += 1
            return True
        return False

    def expect(self, text):
        kind, found = self.take()
        if found.upper() != text:
            raise STError(f"expected {text}, found {found!r} ({kind})")

    def word(self):
        kind, found = self.take()
        if kind != "word" or found.upper() in WORDS or "__" in found or found.endswith("_"):
            raise STError(f"{found!r} is no name")
        return found.lower()

    # ---- declarations --------------------------------------------------------------------------------------------------

    def section(self):
        section = SECTIONS[self.take()[1].upper()]
        if self.accept("CONSTANT"):
            section = "constant"
        while not self.accept("END_VAR"):
            name = self.word()
            if name in self.variables:
                raise STError(f"{name} is declared twice")
            self.expect(":")
            bounds = []
            if self.accept("ARRAY"):
                self.expect("[")
                while not bounds or self.accept(","):
                    low = self.integer()
                    self.expect("..")
                    bounds.append((low, self.integer()))
                self.expect("]")
                self.expect("OF")
            kind = self.take()[1].upper()
            if kind not in TYPES:
                raise STError(f"unknown type {kind}")
            n = math.prod(high - low + 1 for low, high in bounds)
            value = [TYPES[kind]] * n if bounds else TYPES[kind]
            if self.accept(":="):
                value = self.several(kind, n) if bounds else self.literal(kind)
            elif section == "constant":
                raise STError(f"constant {name} has no value")
            self.expect(";")
            self.variables[name] = Variable(section, kind, tuple(bounds), value)

    def several(self, kind, n):
        self.expect("[")
        values = [self.literal(kind)]
        while self.accept(","):
            values.append(self.literal(kind))
        self.expect("]")
        if len(values) != n:
            raise STError(f"{len(values)} values for {n} elements")
        return values

    def integer(self):
        kind, text = self.take()
        if kind != "int":
            raise STError(f"expected a whole number, found {text!r}")
        return int(text)

    def literal(self, wanted):
        sign = -1 if self.accept("-") else 1
        kind, text = self.take()
        if wanted == "BOOL" and text.upper() in ("TRUE", "FALSE"):
            return text.upper() == "TRUE"
        if (kind, wanted) not in (("real", "LREAL"), ("int", "INT")):
            raise STError(f"{text!r} for {wanted}")
        value = sign * (float(text) if kind == "real" else int(text))
        if not math.isfinite(value) or (wanted == "INT" and not -32768 <= value <= 32767):
            raise STError(f"{text} is too large")
        return value

    # ---- statements ----------------------------------------------------------------------------------------------------

    def statements(self, *ends, depth):
        first = len(self.lines)
        while self.peek() not in ends:
            kinds = {"IF": self.choice, "FOR": self.loop, "WHILE": self.repetition, "RETURN": self.end}
            kinds.get(self.peek(), self.assignment)(depth)
            self.expect(";")
        if len(self.lines) == first:
            self.emit(depth, "pass")

    def emit(self, depth, line):
        self.lines.append(" " * depth + line)

    def end(self, depth):
        self.take()
        self.emit(depth, "return")

    def assignment(self, depth):
        name = self.tokens[self.at][1].lower()
        text, kind = self.place()
        if self.variables[name].section in ("constant", "input") or name in self.loops:
            raise STError(f"assignment to {name}")
        self.expect(":=")
        self.emit(depth, f"{text} = {self.of(kind)}")

    def choice(self, depth):
        self.take()
        self.condition(depth, "if", "THEN")
        self.statements("ELSIF", "ELSE", "END_IF", depth=depth + 1)
        while self.accept("ELSIF"):
            self.condition(depth, "elif", "THEN")
            self.statements("ELSIF", "ELSE", "END_IF", depth=depth + 1)
        if self.accept("ELSE"):
            self.emit(depth, "else:")
            self.statements("END_IF", depth=depth + 1)
        self.expect("END_IF")

    def repetition(self, depth):
        self.take()
        self.condition(depth, "while", "DO")
        self.statements("END_WHILE", depth=depth + 1)
        self.expect("END_WHILE")

    def condition(self, depth, word, then):
        self.emit(depth, f"{word} {self.of('BOOL')}:")
        self.expect(then)

    def loop(self, depth):
        self.take()
        name = self.tokens[self.at][1].lower()
        text, kind = self.place()
        if kind != "INT" or name in self.loops or self.variables[name].section != "memory":
            raise STError(f"{name} counts no loop")
        self.expect(":=")
        first = self.of("INT")
        self.expect("TO")
        last = self.of("INT")
        self.expect("DO")
        self.emit(depth, f"for {text} in range({first}, {last} + 1):")
        self.loops.append(name)
        self.statements("END_FOR", depth=depth + 1)
        self.loops.pop()
        self.expect("END_FOR")

    # ---- expressions ----------------------------------------------------------------------------------------------------

    def of(self, wanted):
        text, kind = self.expression(0)
        if kind != wanted:
            raise STError(f"{kind} where {wanted} stands: {text}")
        return text

    def expression(self, level):
        if level == len(LEVELS):
            return self.operand()
        text, kind = self.expression(level + 1)
        while self.peek() in LEVELS[level]:
            sign = self.take()[1].upper()
            other, second = self.expression(level + 1)
            text, kind = self.joined(sign, text, kind, other, second)
        return text, kind

    def joined(self, sign, text, kind, other, second):
        logical = sign in ("AND", "OR", "XOR")
        if kind != second or logical != (kind == "BOOL") or (sign == "/" and kind != "LREAL"):
            raise STError(f"{kind} {sign} {second}")
        python = {"=": "==", "<>": "!=", "AND": "&", "OR": "|", "XOR": "^"}.get(sign, sign)
        compares = sign in ("=", "<>", "<", ">", "<=", ">=")
        return f"({text} {python} {other})", "BOOL" if compares or logical else kind

    def operand(self):
        if self.accept("("):
            inner = self.expression(0)
            self.expect(")")
            return inner
        if self.accept("-"):
            text, kind = self.operand()
            if kind == "BOOL":
                raise STError("minus a BOOL")
            return f"(-{text})", kind
        if self.accept("NOT"):
            text, kind = self.operand()
            if kind != "BOOL":
                raise STError(f"NOT {kind}")
            return f"(not {text})", "BOOL"
        if self.peek() in FUNCTIONS:
            name = self.take()[1].upper()
            self.expect("(")
            arguments = [self.of("LREAL")]
            while self.accept(","):
                arguments.append(self.of("LREAL"))
            self.expect(")")
            if len(arguments) != FUNCTIONS[name][1]:
                raise STError(f"{name} of {len(arguments)}")
            return f"{name}({', '.join(arguments)})", "LREAL"
        kind, text = self.tokens[self.at]
        if kind in ("real", "int"):
            self.at += 1
            return text, "LREAL" if kind == "real" else "INT"
        if text.upper() in ("TRUE", "FALSE"):
            self.at += 1
            return text.capitalize(), "BOOL"
        return self.place()

    def place(self):
        """A variable or an element of an array."""
        name = self.word()
        if name not in self.variables:
            raise STError(f"{name} is not declared")
        own = self.variables[name]
        own.used = True
        if not own.bounds:
            return f"V[{name!r}]", own.kind
        self.expect("[")
        index = [self.of("INT")]
        while self.accept(","):
            index.append(self.of("INT"))
        self.expect("]")
        if len(index) != len(own.bounds):
            raise STError(f"{len(index)} indices for {name}")
        return f"V[{name!r}][at({own.bounds}, {', '.join(index)})]", own.kind
