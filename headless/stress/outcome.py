"""One line of the table of `lumigate bench stress`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Outcome:
    """What was done, by which method, what must hold, what was measured, and whether it holds."""

    case: str
    method: str
    must: str
    value: float
    passed: bool

    def row(self) -> dict:
        """As a row of results.json."""
        return {
            "suite": "stress",
            "case": self.case,
            "method": self.method,
            "must": self.must,
            "value": float(self.value),
            "unit": "",
            "pass": bool(self.passed),
        }
