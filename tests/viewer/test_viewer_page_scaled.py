"""What the gauge `travel` does to tubers, on the card of their camera: in each language, and with its sign."""

from __future__ import annotations

import pytest

from tests.viewer.page_states import good_state, segmenter, with_node
from tests.viewer.test_viewer_page_browser import Browser, browser, js, until_told
from viewer.page.board import Board
from viewer.page.server import PageServer
from viewer.page.snapshot import snapshot

__all__ = ["browser"]
SCALED = {
    "en": "Sizes of tubers are corrected by +1.4 %, as the belt's travel says.",
    "de": "Die Größe der Knollen wird um +1,4 % korrigiert, wie es der Bandweg sagt.",
    "nl": "De maat van knollen wordt met +1,4 % gecorrigeerd, zoals de bandweg zegt.",
    "ja": "塊茎の寸法をベルトの移動量に合わせて +1.4 % 補正しています。",
}


@pytest.mark.parametrize("language", SCALED)
def test_a_camera_whose_tubers_are_scaled_says_so(browser: Browser, language: str) -> None:
    """Below 2 % it stood in exports alone, as the flag `scaled_by_travel` of each tuber."""
    nearer = segmenter("left", gauges={"scaled_by_travel": -0.014, "farther_than_travel": 0.0})
    right = segmenter("right", gauges={"scaled_by_travel": 0.0, "farther_than_travel": 0.0})
    state = with_node(with_node(good_state(), "segmenter/left", nearer), "segmenter/right", right)
    board = Board(["north"])
    with PageServer(board, host="127.0.0.1", port=0) as page:
        board.put(seen := snapshot(state))
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/?lang={language}")
        until_told(browser, board, seen, SCALED[language])
        assert js(browser, "[...document.querySelectorAll('.scaled')].map((place) => place.hidden)") == [False, True]
        further = segmenter("left", gauges={"scaled_by_travel": 0.014, "farther_than_travel": 0.0})
        less = SCALED[language].replace("+1", "−1")
        until_told(browser, board, snapshot(with_node(good_state(), "segmenter/left", further)), less)
