"""The importers by name. A further one is a file of this folder and its entry here."""

from __future__ import annotations

from collections.abc import Mapping

from posegaussian.storage.importers.actorshq import IMPORTER as ACTORSHQ
from posegaussian.storage.importers.caliscope import IMPORTER as CALISCOPE
from posegaussian.storage.importers.colmap import IMPORTER as COLMAP
from posegaussian.storage.importers.declaration import Importer
from posegaussian.storage.importers.dna_rendering import IMPORTER as DNA_RENDERING
from posegaussian.storage.importers.dynacap import IMPORTER as DYNACAP
from posegaussian.storage.importers.easymocap import IMPORTER as EASYMOCAP
from posegaussian.storage.importers.genebody import IMPORTER as GENEBODY
from posegaussian.storage.importers.gps_gaussian import IMPORTER as GPS_GAUSSIAN
from posegaussian.storage.importers.humman import IMPORTER as HUMMAN
from posegaussian.storage.importers.images import IMPORTER as IMAGES
from posegaussian.storage.importers.llff import IMPORTER as LLFF
from posegaussian.storage.importers.mvhumannet import IMPORTER as MVHUMANNET
from posegaussian.storage.importers.nerfstudio import IMPORTER as NERFSTUDIO
from posegaussian.storage.importers.panoptic import IMPORTER as PANOPTIC
from posegaussian.storage.importers.people_snapshot import IMPORTER as PEOPLE_SNAPSHOT
from posegaussian.storage.importers.pose2sim import IMPORTER as POSE2SIM
from posegaussian.storage.importers.videos import IMPORTER as VIDEOS
from posegaussian.storage.importers.zju_mocap import IMPORTER as ZJU_MOCAP

IMPORTERS: Mapping[str, Importer] = {
    i.name: i
    for i in (
        POSE2SIM,
        CALISCOPE,
        EASYMOCAP,
        COLMAP,
        NERFSTUDIO,
        LLFF,
        GPS_GAUSSIAN,
        ZJU_MOCAP,
        DNA_RENDERING,
        PEOPLE_SNAPSHOT,
        HUMMAN,
        ACTORSHQ,
        GENEBODY,
        MVHUMANNET,
        PANOPTIC,
        DYNACAP,
        VIDEOS,
        IMAGES,
    )
}
"""In the order in which sentences name them."""
