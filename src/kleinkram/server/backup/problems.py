"""What is wrong with a backup or its source, a sentence each, in bounded memory however much it is."""

from dataclasses import dataclass, field

MOST_KEPT = 1000


@dataclass
class Problems:
    """`count` is how many there are, `first` what was said of the first thousand."""

    count: int = 0
    first: list[str] = field(default_factory=list)

    def say(self, sentence: str) -> None:
        """Note one."""
        self.count += 1
        if len(self.first) < MOST_KEPT:
            self.first.append(sentence)
