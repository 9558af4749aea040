"""Words by which test engineers name columns.

English, German, French, Spanish, Italian, Chinese and Japanese, without accents. Up to
two letters they are complete words, from three letters on beginnings of words; Chinese
and Japanese ones stand anywhere.
"""

import re
import unicodedata
from dataclasses import dataclass

# By the letter of the channels; "" for columns that are no channels. The first that
# fits counts.
WORDS_OF_CHANNELS = {
    "t": (
        "t time x_value zeit uhrzeit temps heure tiempo hora tempo timestamp secs"
        " время 时间 時間 時刻"
    ),
    "": (
        "temp temperatur thermo datum date fecha scan index sample row nr no status"
        " trigger spare humid 温度 湿度"
    ),
    "a": "acc aceler beschl akzel ускор 加速",
    "F": (
        "force kraft fuerza forza effort load last charge carga carico shaker hammer"
        " impact impakt marteau martillo martello exciter erreger excit vibrodin"
        " dynamom torque drehmoment couple coppia сила нагруз 荷重 力 加振"
    ),
    "x": (
        "disp lvdt laser string drift weg verschieb auslenk deplac desplaz spost dist"
        " abstand potentiom angle winkel angolo angulo перемещ смещ 位移 变位 変位"
    ),
    "v": "vel geschw vitess speed ldv omega drehzahl скорост 速度",
}
MOTION_LETTERS = ("a", "v", "x")
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
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)  # SampleTimeFine
    decomposed = unicodedata.normalize("NFKD", spaced.lower())
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


# Derivatives as mathematicians write them: xddot_1, ddotxg, x1_dd, dotu_top, ug.
_PLACE = r"(?P<{}>\d+|g|gr|ground|base|top|roof)?"
_DOTS = r"(?:ddot|dotdot|dot|dd|d)"
_NOTATIONS = [
    re.compile(rf"(?P<dots>{_DOTS})_?[xu]_?{_PLACE.format('place')}", re.IGNORECASE),
    re.compile(rf"[xu]_?(?P<dots>{_DOTS})_?{_PLACE.format('place')}", re.IGNORECASE),
    re.compile(rf"[xu]_?{_PLACE.format('place')}_?(?P<dots>{_DOTS})", re.IGNORECASE),
    re.compile(rf"(?P<dots>)u_?{_PLACE.format('place')}", re.IGNORECASE),
]


@dataclass(frozen=True)
class Notation:
    """A motion in the notation of mathematics.

    Parameters
    ----------
    letter : {"a", "v", "x"}
    place : str
        A number, a word for the base or the top, or empty.
    """

    letter: str
    place: str


def notation_of(name: str) -> Notation | None:
    """The motion that a name such as ``ddotxg`` means; None for any other name."""
    for pattern in _NOTATIONS:
        match = pattern.fullmatch(name.strip())
        if match is None or (not match["dots"] and not match["place"]):
            continue
        dots = match["dots"].lower().replace("dotdot", "dd").replace("ddot", "dd")
        place = (match["place"] or "").lower()
        letter = {"": "x", "dd": "a"}.get(dots, "v")
        return Notation(letter, "base" if place in ("g", "gr", "0") else place)
    return None


# Directions at the end of a name: of one sensor, or of the sensors of one floor.
_AXIS = re.compile(
    r"(?P<stem>.*?)(?:[\s_\-./:]+|(?<=\d)|(?<=[a-z])(?=[A-Z])|^)"
    r"(?P<axis>[XYZ]|NS|EW|UD|UP|(?<![^\W_])[xyz](?![^\W_])|(?<=\d)[xyz])"
)
VERTICAL = ("Z", "UD", "UP")


def axis_of(name: str) -> tuple[str, str | None]:
    """Name without the direction at its end, and the direction: ``X``, ``NS``, ..."""
    match = _AXIS.fullmatch(name.strip())
    if match is None:
        return name.strip(), None
    return match["stem"].strip(" _-./:"), match["axis"].upper()
