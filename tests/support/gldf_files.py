"""GLDF and L3D files of a box 0.5 x 0.25 x 0.1 m, whose light leaves through its lower face."""

import io
import zipfile

# A box above the plane z = 0, in metres; its lower face is face 3.
CORNERS = [(x, y, z) for x in (0.25, -0.25) for y in (0.125, -0.125) for z in (0.1, 0.0)]
FACES = ["1 5 7 3", "4 3 7 8", "8 7 5 6", "6 2 4 8", "2 1 3 4", "6 5 1 2"]
BOTTOM = 3


def obj(metres=1.0, head="", faces=None):
    """Text of the box in another unit."""
    vertices = [f"v {' '.join(f'{value / metres:.9g}' for value in each)}" for each in CORNERS]
    return "\n".join([head, *vertices, *(f"f {each}" for each in faces or FACES)]) + "\n"


def vector(tag, values):
    x, y, z = values
    return f'<{tag} x="{x}" y="{y}" z="{z}"/>'


def light(name="leo", at=(0, 0, 0), turn=(0, 0, 0), shape='<Rectangle sizeX="0.5" sizeY="0.25"/>'):
    """A light emitting object."""
    return (
        f'<LightEmittingObject partName="{name}">{vector("Position", at)}'
        f"{vector('Rotation', turn)}{shape}</LightEmittingObject>"
    )


def surface(name="leo", faces=(BOTTOM, BOTTOM), group="", intensity=""):
    """A light emitting surface."""
    first, last = faces
    return (
        f'<LightEmittingSurface partName="les-{name}"><LightEmittingObjectReference '
        f'lightEmittingPartName="{name}" {intensity}/><FaceAssignments><FaceRangeAssignment '
        f'faceIndexBegin="{first}" faceIndexEnd="{last}" {group}/></FaceAssignments>'
        "</LightEmittingSurface>"
    )


def part(lights="", surfaces="", at=(0, 0, 0), turn=(0, 0, 0), geometry="box", joints=""):
    """A part of the luminaire."""
    lights = f"<LightEmittingObjects>{lights}</LightEmittingObjects>" if lights else ""
    if surfaces:
        surfaces = f"<LightEmittingSurfaces>{surfaces}</LightEmittingSurfaces>"
    joints = f"<Joints>{joints}</Joints>" if joints else ""
    return (
        f'<Geometry partName="p">{vector("Position", at)}{vector("Rotation", turn)}'
        f'<GeometryReference geometryId="{geometry}"/>{joints}{lights}{surfaces}</Geometry>'
    )


def joint(child, at=(0, 0, 0), turn=(0, 0, 0), default=None):
    """A joint with a part behind it."""
    default = "" if default is None else vector("DefaultRotation", default)
    return (
        f'<Joint partName="j">{vector("Position", at)}{vector("Rotation", turn)}{default}'
        f"<Geometries>{child}</Geometries></Joint>"
    )


def structure(parts=None, units="m", file="box.obj"):
    """The XML of an L3D file."""
    parts = part(light(), surface()) if parts is None else parts
    return (
        '<?xml version="1.0" encoding="UTF-8"?><Luminaire><Header/><GeometryDefinitions>'
        f'<GeometryFileDefinition id="box" filename="{file}" units="{units}"/>'
        f"</GeometryDefinitions><Structure>{parts}</Structure></Luminaire>"
    )


def zipped(files):
    """Bytes of a zip archive of texts or bytes by name."""
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return result.getvalue()


def l3d(xml=None, **models):
    """Bytes of an L3D file with the box, or with other files in its folder."""
    models = models or {"box.obj": obj()}
    files = {f"box/{name.replace('_', '.')}": text for name, text in models.items()}
    return zipped({"structure.xml": structure() if xml is None else xml, **files})


def emitter(name="e", photometry="photometry", lumens="", rest="", attributes=""):
    """A fixed light emitter."""
    rated = f"<RatedLuminousFlux>{lumens}</RatedLuminousFlux>" if lumens else ""
    return (
        f'<Emitter id="{name}"><FixedLightEmitter {attributes}>{rest}<PhotometryReference '
        f'photometryId="{photometry}"/>{rated}</FixedLightEmitter></Emitter>'
    )


def in_model(emitters, geometry="geometry"):
    """The geometry of a variant with a 3D model; `emitters` are emitters by names of objects."""
    found = "".join(
        f'<EmitterReference emitterId="{each}"><EmitterObjectExternalName>{name}'
        "</EmitterObjectExternalName></EmitterReference>"
        for name, each in emitters.items()
    )
    return f'<ModelGeometryReference geometryId="{geometry}">{found}</ModelGeometryReference>'


def variant(geometry=None, name="v", attributes=""):
    """A variant of a product."""
    geometry = in_model({"leo": "e"}) if geometry is None else geometry
    return (
        f'<Variant id="{name}" {attributes}><Name><Locale language="en">name of {name}</Locale>'
        f"</Name><Geometry>{geometry}</Geometry></Variant>"
    )


FILES = (
    '<File id="ldc" contentType="ldc/eulumdat" type="localFileName">lamp.ldt</File>'
    '<File id="geo" contentType="geo/l3d" type="localFileName">lamp.l3d</File>'
)


def product(
    variants=None, emitters=None, files=FILES, photometries="", general="", head="<Header/>"
):
    """The XML of a GLDF file."""
    geometries = (
        '<ModelGeometry id="geometry"><GeometryFileReference fileId="geo"/></ModelGeometry>'
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?><Root>'
        f"{head}<GeneralDefinitions><Files>{files}</Files><Photometries>"
        '<Photometry id="photometry"><PhotometryFileReference fileId="ldc"/></Photometry>'
        f"{photometries}</Photometries><Emitters>{emitters or emitter()}</Emitters>"
        f"<Geometries>{geometries}{general}</Geometries></GeneralDefinitions>"
        "<ProductDefinitions><ProductMetaData><Name><Locale language='en'>lamp</Locale></Name>"
        f"</ProductMetaData><Variants>{variants or variant()}</Variants></ProductDefinitions>"
        "</Root>"
    )
