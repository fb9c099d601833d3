from . import metrics, preview
from .brdf.abc import ABC, SmoothABC
from .brdf.adaptive import AdaptiveBRDF
from .brdf.ashikhmin_materials import ASHIKHMIN_MATERIALS, ashikhmin_material
from .brdf.ashikhmin_shirley import (
    AshikhminShirley,
    AshikhminShirleyDiffuse,
    AshikhminShirleyLobe,
)
from .brdf.base import AbstractBRDF, AbstractSum, Scaled, Sum
from .brdf.cook_torrance import CookTorrance
from .brdf.facet_scattering import FacetScattering
from .brdf.free_form import FreeFormBRDF
from .brdf.generated import (
    CoupledDiffuse,
    GeneratedBRDF,
    GeneratedMetal,
    HemisphericalReflectance,
    tabulate_reflectance,
)
from .brdf.kirchhoff import KirchhoffBRDF
from .brdf.lafortune import Lafortune
from .brdf.lambertian import Lambertian
from .brdf.measured import MeasuredBRDF, Slices
from .brdf.microfacet import Microfacet
from .brdf.oren_nayar import OrenNayar
from .brdf.phong import BlinnPhongBRDF, Phong
from .brdf.rough_metal import RoughMetal
from .brdf.shifted_gamma import ShiftedGammaBRDF
from .brdf.spatially_varying import SpatiallyVaryingBRDF
from .brdf.ward import Ward, WardDuer
from .checks import energy_excess, reciprocity_error
from .directions import (
    dot,
    from_frame,
    from_half_difference,
    half_vector,
    reflect,
    spherical,
    to_frame,
    to_half_difference,
    to_spherical,
)
from .energy import albedo, largest_albedo
from .fit_result import FitResult, FitStatus
from .fresnel import (
    AbstractFresnel,
    Conductor,
    Constant,
    Dielectric,
    Lazanyi,
    LinearSchlick,
    Schlick,
    kappa_from_reflectance,
)
from .goniometry import (
    AbstractSignature,
    GaussianSignature,
    MeasuredSignature,
    blurred,
    effective_density,
    effective_ndf,
    half_directions,
    scattering_wavelength,
)
from .metrics import Comparison, compare, normalized_l2
from .ndf.base import AbstractIsotropicNDF, AbstractNDF, AbstractVisibleNDF
from .ndf.beckmann import Beckmann
from .ndf.blinn_phong import AnisotropicPhong, BlinnPhong
from .ndf.ellipsoid import Ellipsoid, aligned
from .ndf.exponential import Exponential
from .ndf.gaussian_microfacets import GaussianCylinder, GaussianMicrofacets
from .ndf.grooves import VGrooves
from .ndf.mixture import Mixture, facet_area, mixture
from .ndf.modulated import Modulated
from .ndf.shifted_gamma import ShiftedGamma
from .ndf.student_t import StudentT
from .ndf.tabulated import TabulatedNDF
from .ndf.tabulated_area import TabulatedArea, tabulate_projected_area
from .ndf.trowbridge_reitz import TrowbridgeReitz
from .ndf.velvet import SlantedVelvet, Velvet
from .preview import Appearance, lab_difference, render
from .quadrature import HalfDifferenceGrid, hemisphere, merl_grid
from .resampling import ResamplingError, as_adaptive, as_samples, as_table, resampling_error
from .samples import MeasuredSamples
from .scattered import SampleAlbedos, sample_albedos
from .scene import Lamp, Scene, Surroundings, lit_sphere, lit_surface
from .shadowing import (
    AbstractShadowing,
    AzimuthCorrelated,
    FreeTravel,
    HeightCorrelated,
    ShiftedGammaShadowing,
    Uncorrelated,
    Unshadowed,
    VCavity,
    smith_G1,
)
from .special import log_upper_gamma, upper_gamma
from .surface.heightfield import Heightfield
from .surface.kirchhoff import coherent_patches, kirchhoff_brdf, kirchhoff_ndf, resolved_angle
from .surface.levelling import levelled, without_outliers
from .surface.ndf_map import NDFMap, aligned_maps, ndf_map, ndf_texture, ndf_texture_of_strips
from .surface.normals import facet_ndf, filtered_ndf, filtered_normals, mean_ndf
from .surface.patches import PatchNDFs, patch_ndfs
from .surface.plane_fit import default_sigma
from .surface.random_surface import gaussian_surface
from .surface.texture import synthesize_texture, texture_like
from .surface.visibility import virtual_goniometer, visibility, visible_facets

__all__ = [
    "ABC",
    "ASHIKHMIN_MATERIALS",
    "AbstractBRDF",
    "AbstractFresnel",
    "AbstractIsotropicNDF",
    "AbstractNDF",
    "AbstractShadowing",
    "AbstractSignature",
    "AbstractSum",
    "AbstractVisibleNDF",
    "AdaptiveBRDF",
    "AnisotropicPhong",
    "Appearance",
    "AshikhminShirley",
    "AshikhminShirleyDiffuse",
    "AshikhminShirleyLobe",
    "AzimuthCorrelated",
    "Beckmann",
    "BlinnPhong",
    "BlinnPhongBRDF",
    "Comparison",
    "Conductor",
    "Constant",
    "CookTorrance",
    "CoupledDiffuse",
    "Dielectric",
    "Ellipsoid",
    "Exponential",
    "FacetScattering",
    "FitResult",
    "FitStatus",
    "FreeFormBRDF",
    "FreeTravel",
    "GaussianCylinder",
    "GaussianMicrofacets",
    "GaussianSignature",
    "GeneratedBRDF",
    "GeneratedMetal",
    "HalfDifferenceGrid",
    "HeightCorrelated",
    "Heightfield",
    "HemisphericalReflectance",
    "KirchhoffBRDF",
    "Lafortune",
    "Lambertian",
    "Lamp",
    "Lazanyi",
    "LinearSchlick",
    "MeasuredBRDF",
    "MeasuredSamples",
    "MeasuredSignature",
    "Microfacet",
    "Mixture",
    "Modulated",
    "NDFMap",
    "OrenNayar",
    "PatchNDFs",
    "Phong",
    "ResamplingError",
    "RoughMetal",
    "SampleAlbedos",
    "Scaled",
    "Scene",
    "Schlick",
    "ShiftedGamma",
    "ShiftedGammaBRDF",
    "ShiftedGammaShadowing",
    "SlantedVelvet",
    "Slices",
    "SmoothABC",
    "SpatiallyVaryingBRDF",
    "StudentT",
    "Sum",
    "Surroundings",
    "TabulatedArea",
    "TabulatedNDF",
    "TrowbridgeReitz",
    "Uncorrelated",
    "Unshadowed",
    "VCavity",
    "VGrooves",
    "Velvet",
    "Ward",
    "WardDuer",
    "albedo",
    "aligned",
    "aligned_maps",
    "as_adaptive",
    "as_samples",
    "as_table",
    "ashikhmin_material",
    "blurred",
    "coherent_patches",
    "compare",
    "default_sigma",
    "dot",
    "effective_density",
    "effective_ndf",
    "energy_excess",
    "facet_area",
    "facet_ndf",
    "filtered_ndf",
    "filtered_normals",
    "from_frame",
    "from_half_difference",
    "gaussian_surface",
    "half_directions",
    "half_vector",
    "hemisphere",
    "kappa_from_reflectance",
    "kirchhoff_brdf",
    "kirchhoff_ndf",
    "lab_difference",
    "largest_albedo",
    "levelled",
    "lit_sphere",
    "lit_surface",
    "log_upper_gamma",
    "mean_ndf",
    "merl_grid",
    "metrics",
    "mixture",
    "ndf_map",
    "ndf_texture",
    "ndf_texture_of_strips",
    "normalized_l2",
    "patch_ndfs",
    "preview",
    "reciprocity_error",
    "reflect",
    "render",
    "resampling_error",
    "resolved_angle",
    "sample_albedos",
    "scattering_wavelength",
    "smith_G1",
    "spherical",
    "synthesize_texture",
    "tabulate_projected_area",
    "tabulate_reflectance",
    "texture_like",
    "to_frame",
    "to_half_difference",
    "to_spherical",
    "upper_gamma",
    "virtual_goniometer",
    "visibility",
    "visible_facets",
    "without_outliers",
]
