"""`neumip`: a neural material as a BSDF of Mitsuba 3, in every RGB variant.

    import mitsuba as mi
    mi.set_variant("llvm_ad_rgb")
    import neumip_bsdf                      # registers the plugin; after another set_variant call neumip_bsdf.register()
    sphere = {"type": "sphere", "bsdf": {"type": "neumip", "bundle": "BUNDLE", "tiling": "8 4"}}

| property | meaning |
| --- | --- |
| `bundle` | the folder that `neumip export` wrote |
| `tiling` | tiles along u and v: "8 4", or one number for both; 1 |
| `scale` | factor on the answers; 1 |
| `level` | the level of every answer; absent: from the footprint |
| `level_bias` | added to a footprint's level; 0 |
| `pixel_angle` | angle between pixels in radians, for integrators that give no differentials; 0 |

A footprint comes from `si.duv_dx` and `si.duv_dy`. The scalar `direct` fills them; `path` does not, and neither does any
integrator in C++ of the other variants. There it is what `pixel_angle` spans at the distance of the last segment; where that
is 0 too, the level is 0, which is right and noisier. The surface needs texture coordinates (`check` says which has none). The
material is black from below, and not symmetric in its directions: only integrators that start at the camera work.
"""

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from neumip_answer import Answerer, Lobes
from neumip_bundle import Bundle, BundleError

# BSDFFlags::NeedsDifferentials, which Python's BSDFFlags lacks.
NEEDS_DIFFERENTIALS = 0x20000


def register():
    """Registers `neumip` for the variant that is set."""

    class Neumip(mi.BSDF):
        def __init__(self, properties):
            super().__init__(properties)
            if not mi.variant().endswith("_rgb"):
                known = "llvm_ad_rgb, cuda_ad_rgb or scalar_rgb"
                raise BundleError(f"neumip: the variant {mi.variant()} is not RGB; set {known}")
            bundle = Bundle(properties["bundle"])
            self.answerer = Answerer(bundle)
            self.tiling = two_numbers(properties.get("tiling", 1.0))
            self.scale = properties.get("scale", 1.0)
            self.level = properties.get("level", None)
            self.level_bias = properties.get("level_bias", 0.0)
            self.pixel_angle = properties.get("pixel_angle", 0.0)
            numbers = [*self.tiling, self.scale, self.level_bias, self.pixel_angle, self.level or 0.0]
            if not all(map(math.isfinite, numbers)) or 0.0 in self.tiling or self.scale < 0 or self.pixel_angle < 0:
                names = "tiling, scale, level_bias, pixel_angle or level"
                raise BundleError(f"neumip: {names} is no usable number: {numbers}")
            self.name = bundle.description["material"]
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.SpatiallyVarying
            self.m_components = [int(flags) | NEEDS_DIFFERENTIALS]
            self.m_flags = int(flags) | NEEDS_DIFFERENTIALS

        def footprint_level(self, si):
            height, width = self.answerer.tile
            texels = height * width * abs(self.tiling[0] * self.tiling[1])
            area = dr.abs(si.duv_dx.x * si.duv_dy.y - si.duv_dx.y * si.duv_dy.x)
            if self.pixel_angle > 0.0:
                around = dr.square(si.t * self.pixel_angle) / dr.maximum(dr.abs(si.wi.z), 1e-4)
                stretch = dr.maximum(dr.norm(dr.cross(si.dp_du, si.dp_dv)), 1e-20)
                area = dr.select(area > 0.0, area, around / stretch)
            return 0.5 * dr.log2(dr.maximum(area * texels, 1e-20)) + self.level_bias

        def frame_sign(self, si):
            """-1 where v runs against Mitsuba's second axis: our y axis always runs along v."""
            return dr.select(dr.dot(si.sh_frame.t, si.dp_dv) < 0.0, -1.0, 1.0)

        def prepare(self, ctx, si):
            if ctx.mode == mi.TransportMode.Importance:
                raise RuntimeError("neumip: only integrators that start at the camera work")
            sign = self.frame_sign(si) * math.copysign(1.0, self.tiling[0] * self.tiling[1])
            level = self.footprint_level(si) if self.level is None else mi.Float(self.level)
            u = (si.uv.x * self.tiling[0], si.uv.y * self.tiling[1])
            return self.answerer.prepare(u, oriented(si.wi, sign), level), sign

        def sample(self, ctx, si, sample1, sample2, active):
            prepared, sign = self.prepare(ctx, si)
            lobes = Lobes(self.answerer, prepared)
            wi = lobes.sample(sample1, sample2)
            sample = mi.BSDFSample3f()
            sample.wo = oriented(wi, sign)
            sample.pdf = dr.select(active, lobes.pdf(wi), 0.0)
            sample.eta = 1.0
            sample.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            sample.sampled_component = mi.UInt32(0)
            value = self.answerer.evaluate(prepared, wi) * self.scale
            return sample, mi.Color3f(dr.select(sample.pdf > 0.0, value / sample.pdf, 0.0))

        def eval(self, ctx, si, wo, active):
            prepared, sign = self.prepare(ctx, si)
            return mi.Color3f(dr.select(active, self.answerer.evaluate(prepared, oriented(wo, sign)) * self.scale, 0.0))

        def pdf(self, ctx, si, wo, active):
            prepared, sign = self.prepare(ctx, si)
            return dr.select(active, Lobes(self.answerer, prepared).pdf(oriented(wo, sign)), 0.0)

        def eval_pdf(self, ctx, si, wo, active):
            prepared, sign = self.prepare(ctx, si)
            wi = oriented(wo, sign)
            value = self.answerer.evaluate(prepared, wi) * self.scale
            return (
                mi.Color3f(dr.select(active, value, 0.0)),
                dr.select(active, Lobes(self.answerer, prepared).pdf(wi), 0.0),
            )

        def to_string(self):
            return f"Neumip[{self.name}]"

    mi.register_bsdf("neumip", Neumip)
    return Neumip


def oriented(w, sign):
    return mi.Vector3f(w.x, w.y * sign, w.z)


def two_numbers(text):
    """A number or two in text as [a, b]."""
    try:
        numbers = [float(part) for part in str(text).replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise BundleError(f"neumip: tiling is `{text}`; give one number or two, such as \"8 4\"")
    return [numbers[0], numbers[-1]]


def check(scene):
    """Raises `BundleError` for a mesh that has a neural material and no texture coordinates to look it up with."""
    for shape in scene.shapes():
        if not shape.is_mesh() or "Neumip[" not in str(shape.bsdf()):
            continue
        if not shape.has_vertex_texcoords():
            raise BundleError(f"{shape.id()}: the mesh has no texture coordinates, which a neural material needs")
        arrays = mi.traverse(shape)
        # A rectangle is a mesh whose arrays are not shown.
        if "vertex_texcoords" not in arrays:
            continue
        corners = np.array(arrays["vertex_texcoords"]).reshape(-1, 2)[np.array(arrays["faces"]).reshape(-1, 3)]
        sides = corners[:, 1:] - corners[:, :1]
        area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
        # Written so that a NaN counts; single triangles without area are usual at poles.
        lost = int(np.sum(~(np.abs(area) > 0.0)))
        if 2 * lost > len(area):
            raise BundleError(f"{shape.id()}: {lost} of {len(area)} triangles have texture coordinates without area")


if mi.variant():
    register()
