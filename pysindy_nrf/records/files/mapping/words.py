"""Words by which test engineers name columns.

English, German, French, Spanish, Italian, Chinese and Japanese, without accents. Up to
two letters they are whole words, from three letters on beginnings of words; Chinese and
Japanese ones stand anywhere.
"""

import re
import unicodedata

# By the letter of the channels; "" for columns that are no channels. The first that
# fits counts.
WORDS_OF_CHANNELS = {
    "t": "t time x_value zeit temps tiempo tempo timestamp secs 时间 時間 時刻",
    "": (
        "temp temperatur thermo scan index sample row nr no status trigger spare humid"
        " 温度 湿度"
    ),
    "a": "acc aceler beschl akzel 加速",
    "F": (
        "force kraft fuerza forza effort load last charge carga carico shaker hammer"
        " impact impakt marteau martillo martello exciter erreger excit vibrodin"
        " dynamom 荷重 力 加振"
    ),
    "x": (
        "disp lvdt laser string weg verschieb auslenk deplac desplaz spost dist abstand"
        " potentiom 位移 变位 変位"
    ),
    "v": "vel geschw vitess speed ldv 速度",
}
WORDS_OF_BASE = (
    "ag xg vg base basis ground boden table tisch sol suelo terreno fundament"
    " foundation fondation mesa tavola 台 地"
)
WORDS_OF_TOP = "top roof dach oben toit sommet techo cubierta tetto sommita 屋 顶 頂 上"
EASTERN_WORDS = [
    word
    for words in WORDS_OF_CHANNELS.values()
    for word in words.split()
    if not word.isascii()
]


def names_one_of(name: str, words: str) -> bool:
    """Whether the name of a column holds one of some words."""
    decomposed = unicodedata.normalize("NFKD", name.lower())
    plain = "".join(c for c in decomposed if not unicodedata.combining(c))
    words_of_name = re.findall(r"[^\W\d_]+", plain)
    return any(_contains(word, plain, words_of_name) for word in words.split())


def _contains(word: str, name: str, words_of_name: list[str]) -> bool:
    """Whether a name contains a word; short words must be whole ones of the name."""
    if not word.isascii() or "_" in word:
        return word in name
    if len(word) < 3:
        return word in words_of_name
    return any(candidate.startswith(word) for candidate in words_of_name)


def letter_named(name: str) -> str | None:
    """Letter of the channels that the words of a name mean.

    ``""`` if they mean no channel, None if no word is known.
    """
    for letter, words in WORDS_OF_CHANNELS.items():
        if names_one_of(name, words):
            return letter
    return None
