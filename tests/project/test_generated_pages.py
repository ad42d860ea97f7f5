"""Pages of the documentation that are made from data say what the data says."""

from tools.make_link_policy import PAGE, page


def test_the_page_of_the_link_policy_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run: python -m tools.make_link_policy"
