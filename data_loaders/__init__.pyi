from .alta import read_alta, write_alta
from .colours import to_rgb
from .cornell import read_cornell
from .csv_table import read_csv, write_csv
from .errors import DataError
from .formats import read_brdf, recognise, write_brdf
from .hdf5_record import read_about
from .heightfield import read_heightfield, scan_files, write_heightfield
from .json_record import fit_to_json
from .merl import read_merl, read_merl_slices, write_merl
from .minidiff import read_minidiff
from .ndf_file import read_ndf, write_ndf
from .ndf_map_file import read_ndf_maps, write_ndf_maps
from .optical_constants import OpticalConstants, conductor_from_colour, optical_constants
from .published import published, published_materials, published_parameters
from .rgl import read_rgl, write_rgl
from .store import load_fit, read_hdf5, save_fit, write_hdf5

__all__ = [
    "DataError",
    "OpticalConstants",
    "conductor_from_colour",
    "fit_to_json",
    "load_fit",
    "optical_constants",
    "published",
    "published_materials",
    "published_parameters",
    "read_about",
    "read_alta",
    "read_brdf",
    "read_cornell",
    "read_csv",
    "read_hdf5",
    "read_heightfield",
    "read_merl",
    "read_merl_slices",
    "read_minidiff",
    "read_ndf",
    "read_ndf_maps",
    "read_rgl",
    "recognise",
    "save_fit",
    "scan_files",
    "to_rgb",
    "write_alta",
    "write_brdf",
    "write_csv",
    "write_hdf5",
    "write_heightfield",
    "write_merl",
    "write_ndf",
    "write_ndf_maps",
    "write_rgl",
]
