"""The pages of a folder of lamps, and the search in them."""

import json
import os
import re
import shutil
import subprocess

import pytest

from lumitree.core.files import exclusive
from lumitree.errors import LumitreeError
from lumitree.fit.catalogue import index as folder_index
from lumitree.fit.catalogue import page as page_module
from lumitree.fit.catalogue.folder import Part, write_part
from lumitree.fit.catalogue.index import FolderIndex, check_index
from lumitree.fit.catalogue.record import BakedLamp, LampFiles
from support.baked_folders import write_lamp
from support.browser import CHROMIUM

PAGES = "index-files/folder"
STRANGE = 'a & "b" <i>%#?'


def write(folder, lamps=()):
    FolderIndex(folder).write(lamps)
    return (folder / "index.html").read_text()


def links(page, attribute):
    return re.findall(rf'{attribute}="([^"]*)"', page)


def test_a_page_links_to_files_beside_it(tmp_path):
    write_lamp(tmp_path, "b")
    write_lamp(tmp_path, "A")
    page = write(tmp_path)
    assert links(page, "href") == ["A.lumitree", "b.lumitree"]
    assert links(page, "src") == [
        "index-files/A.webp",
        "index-files/b.webp",
        f"{PAGES}/search.js",
    ]
    for each in links(page, "href") + links(page, "src"):
        assert (tmp_path / each).is_file()
    assert "2 lamps." in page
    assert "<dt>flux</dt><dd>1,234 lm</dd>" in page
    assert "<nav>" not in page
    # Nothing of another place is loaded.
    assert not re.search(r"https?:|url\(|@import|<link|base64", page)


def test_lamps_are_divided_into_pages(tmp_path, monkeypatch):
    monkeypatch.setattr(page_module, "LAMPS_A_PAGE", 4)
    for number in range(10):
        write_lamp(tmp_path, f"{number:03d}")
    first = write(tmp_path)
    second = (tmp_path / PAGES / "2.html").read_text()
    third = (tmp_path / PAGES / "3.html").read_text()
    assert [page.count("<article>") for page in (first, second, third)] == [4, 4, 2]
    assert "10 lamps." in second
    assert links(first, "href")[:2] == [f"{PAGES}/2.html", f"{PAGES}/3.html"]
    for page in (second, third):
        for each in links(page, "href") + links(page, "src"):
            assert (tmp_path / PAGES / each).resolve().is_file()
    for number in range(4, 10):
        (tmp_path / f"{number:03d}.lumitree").unlink()
    write(tmp_path)
    assert sorted(os.listdir(tmp_path / PAGES)) == ["names.js", "search.js"]


def test_only_pages_that_change_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(page_module, "LAMPS_A_PAGE", 2)
    for number in range(5):
        write_lamp(tmp_path, str(number))
    write(tmp_path)
    times = {name: (tmp_path / PAGES / name).stat().st_mtime_ns for name in ("2.html", "3.html")}
    write_lamp(tmp_path, "4", seconds=77.0)
    write(tmp_path)
    after = {name: (tmp_path / PAGES / name).stat().st_mtime_ns for name in times}
    assert after["2.html"] == times["2.html"]
    assert after["3.html"] > times["3.html"]


def test_states_are_shown(tmp_path):
    write_lamp(tmp_path, "done")
    write_lamp(tmp_path, "half", finished=False)
    LampFiles(tmp_path, "dark").write_failure("holds no <emitter>")
    write_part(tmp_path, Part(1, 2), ["done", "later", "dark"])
    # It failed, and is in no list any more.
    LampFiles(tmp_path, "gone").write_failure("holds no <emitter>")
    page = write(tmp_path, [BakedLamp("own", "own.xml", "waiting")])
    assert "5 lamps (1 interrupted, 1 failed, 2 not baked yet)." in page
    assert '<div class="failed">failed: holds no &lt;emitter&gt;</div>' in page
    assert "interrupted; the same command continues" in page
    assert page.count("<dt>flux</dt>") == 2


def test_names_are_escaped(tmp_path):
    write_lamp(tmp_path, STRANGE)
    page = write(tmp_path)
    assert 'href="a%20%26%20%22b%22%20%3Ci%3E%25%23%3F.lumitree"' in page
    assert "<i>" not in page
    names = (tmp_path / PAGES / "names.js").read_text()
    (row,) = json.loads(names.removeprefix("window.lumitreeLamps=").rstrip(";\n"))
    assert row == [STRANGE, "webp", 1, "1,234 lm"]


def test_pages_are_written_in_a_bounded_share_of_the_time(tmp_path, monkeypatch):
    now = [1000.0]

    def write_slowly(path, content):
        now[0] += 1.0

    monkeypatch.setattr(folder_index.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(folder_index, "write_bytes", write_slowly)
    pages = FolderIndex(tmp_path)
    pages.update([])
    # Three files of one second each: not again for 30 s.
    assert now[0] == 1003.0
    for later, expected in ((1032.9, 1032.9), (1033.0, 1036.0)):
        now[0] = later
        pages.update([])
        assert now[0] == expected
    pages.write([])
    assert now[0] == 1039.0


def test_one_process_writes_at_a_time(tmp_path):
    write_lamp(tmp_path, "a")
    with exclusive(tmp_path / PAGES / "writing.lock") as held:
        assert held
        FolderIndex(tmp_path).update([])
        assert not (tmp_path / "index.html").exists()
    FolderIndex(tmp_path).update([])
    assert (tmp_path / "index.html").exists()


def test_pages_of_others_are_refused(tmp_path):
    path = tmp_path / "index.html"
    check_index(path)
    path.write_text("<title>mine</title>")
    with pytest.raises(LumitreeError, match="is not a page of lumitree"):
        check_index(path)
    path.write_text(write(tmp_path / "other"))
    check_index(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(LumitreeError, match="is a folder"):
        check_index(path)


SEARCH = """
<script>
const wait = (t) => new Promise((done) => setTimeout(done, t));
const search = async (text) => {
  const field = document.querySelector("input");
  field.focus(); field.dispatchEvent(new Event("focus"));
  for (let i = 0; i < 500 && !window.lumitreeLamps; i++) { await wait(10); }
  field.value = text; field.dispatchEvent(new Event("input"));
  const found = document.querySelector("#found");
  return [document.querySelector("#count").textContent, found.hidden,
    document.querySelector("main").hidden,
    [...found.querySelectorAll("article")].map((each) => [each.querySelector("h2").textContent,
      each.querySelector("a")?.href, each.querySelector("img")?.src])];
};
(async () => {
  const answers = [];
  for (const text of QUERIES) { answers.push(await search(text)); }
  document.body.textContent = "ANSWER" + JSON.stringify(answers) + "END";
})();
</script></body>"""


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.parametrize("page", ["index.html", f"{PAGES}/2.html"])
def test_search_works_in_a_page_that_is_opened_as_a_file(tmp_path, page):
    root = tmp_path / "lamps"
    for number in range(210):
        write_lamp(root, f"lamp {number:03d}")
    write_lamp(root, STRANGE)
    LampFiles(root, "dark").write_failure("holds no emitter")
    write(root)
    text = (root / page).read_text()
    queries = ["LAMP 20", STRANGE.split()[0] + " &", "failed", "lamp", ""]
    text = text.replace("</body>", SEARCH.replace("QUERIES", json.dumps(queries)))
    (root / page).write_text(text)
    shown = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--virtual-time-budget=20000", "--dump-dom",
         f"--user-data-dir={tmp_path / 'profile'}", (root / page).as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    ).stdout  # fmt: skip
    shutil.rmtree(tmp_path / "profile", ignore_errors=True)
    answers = json.loads(
        re.search("ANSWER(.*)END", shown)[1]
        .replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    )  # fmt: skip
    twenty, strange, failed, all_lamps, none = answers
    assert twenty[0] == "12 found."
    assert twenty[1:3] == [False, True]
    assert twenty[3][0] == [
        "lamp 020",
        (root / "lamp 020.lumitree").as_uri(),
        (root / "index-files/lamp 020.webp").as_uri(),
    ]
    assert [each[0] for each in strange[3]] == [STRANGE]
    assert failed[3] == [["dark", None, None]]
    assert all_lamps[0] == "210 found, of which 200 are shown."
    assert len(all_lamps[3]) == 200
    assert none[:3] == ["212 lamps (1 failed).", True, False]
