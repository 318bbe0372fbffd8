"""The equation of a plant in parts: the laws of its effects taken out, so that what is off need not be computed."""

from collections.abc import Collection, Mapping
from dataclasses import replace

import casadi as ca

from workbench.physics.effects.effect import Effect, Named
from workbench.physics.symbolic import column, entries
from workbench.records import record


@record
class Part:
    """What one law gives: its values (n, 1), the symbols (n, 1) that stand for them, and the indices in eta of its sizes.

    While all its sizes are 0, the values are 0. They may hold the symbols of the earlier parts whose indices are in `after`.
    """

    sizes: tuple[int, ...]
    values: ca.SX
    symbols: ca.SX
    after: tuple[int, ...]


@record
class Parted:
    """Rates of change of the states and of the effects' own states (n, 1), in terms of the parts."""

    rates: ca.SX
    parts: tuple[Part, ...]


class Opened:
    """Effects whose laws are written down apart while an equation is traced."""

    def __init__(self, symbols: Mapping[str, ca.SX]):
        self.moving = ca.vertcat(*(symbol for name, symbol in symbols.items() if name not in ("p", "eta")))
        self.parts: list[Part] = []

    def stand_in(self, effect: Effect, numbers: Mapping[str, int]) -> Effect:
        """The effect with a law that notes its values and returns symbols."""
        sizes = tuple(numbers[p.name] for p in effect.sizes)

        def law(*arguments):
            result = effect.law(*arguments)
            values = list(result) if isinstance(result, tuple) else [result]
            # what does not change during a run is computed once and needs no part
            own = [i for i, value in enumerate(values) if ca.depends_on(ca.SX(value), self.moving)]
            if own:
                symbols, taken = ca.SX.sym(f"part{len(self.parts)}", len(own)), column([values[i] for i in own])
                after = tuple(j for j, part in enumerate(self.parts) if ca.depends_on(taken, part.symbols))
                self.parts.append(Part(sizes, taken, symbols, after))
                self.moving = ca.vertcat(self.moving, symbols)
                for i, symbol in zip(own, entries(symbols), strict=True):
                    values[i] = symbol
            return tuple(values) if isinstance(result, tuple) else values[0]

        return replace(effect, law=law)


class Noted:
    """The view that the law of one effect gets, noted while an equation is computed; numbers: indices of the effect's numbers."""

    def __init__(self, numbers: Collection[int]):
        self.numbers = set(numbers)
        self.seen = Named({})

    def stand_in(self, effect: Effect, numbers: Mapping[str, int]) -> Effect:
        """The effect, or the one that is looked for with a law that notes what it sees."""
        if set(numbers.values()) != self.numbers:
            return effect

        def law(e, seen, *more):
            self.seen = seen
            return effect.law(e, seen, *more)

        return replace(effect, law=law)
