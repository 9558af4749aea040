"""Reading and writing of files, under the name that users write."""

from .records.files import *
from .records.files import __all__ as __all__
