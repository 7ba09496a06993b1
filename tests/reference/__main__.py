"""Write the generated parts of all README files: python -m reference, in tests/."""

from pathlib import Path

from reference.pages import SOURCES, generated

REPOSITORY = Path(__file__).resolve().parents[2]


def main() -> None:
    """Write each page with changed generated parts, and print its name."""
    for page in SOURCES:
        text = generated(REPOSITORY, page)
        if text != (REPOSITORY / page).read_text():
            (REPOSITORY / page).write_text(text)
            print(page)  # noqa: T201


if __name__ == "__main__":
    main()
