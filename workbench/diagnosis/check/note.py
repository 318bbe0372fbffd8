"""A note on a record's channel: what the check of records says without refusing them."""

from workbench.records import record


@record
class Note:
    """One sentence on a record's channel that does not keep it from being used."""

    record: str
    channel: str
    sentence: str

    def __str__(self) -> str:
        return f"{self.record}, {self.channel}: {self.sentence}" if self.channel else f"{self.record}: {self.sentence}"
