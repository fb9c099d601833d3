from .errors import DataError
from .json_record import fit_to_json
from .merl import read_merl, read_merl_slices, write_merl
from .published import published, published_materials
from .recognise import read_brdf
from .store import load_fit, save_fit

__all__ = [
    "DataError",
    "fit_to_json",
    "load_fit",
    "published",
    "published_materials",
    "read_brdf",
    "read_merl",
    "read_merl_slices",
    "save_fit",
    "write_merl",
]
