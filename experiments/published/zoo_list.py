"""The list of published networks that are tried, fixed before the operations that they need.

Networks of event cameras are in `event_networks.py`. The others are what event-camera work takes
from libraries: classifiers of torchvision and timm, and segmentation networks. All have two input
channels (ON and OFF) where the library lets one choose, and random weights.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Entry:
    """A network of the list.

    Parameters
    ----------
    name : name in the list.
    source : "events", "torchvision", "timm" or "segmentation".
    builder : what builds it: a function of `event_networks.py`, a name of the library, or
        "DECODER/ENCODER".
    shape : shape of its input, (C, H, W).
    """

    name: str
    source: str
    builder: str
    shape: tuple[int, int, int]


EVENTS = {
    "nir_nmnist": (2, 34, 34),
    "roshambo": (1, 64, 64),
    "gesture_cnn": (6, 64, 64),
    "decolle_gesture": (2, 32, 32),
    "speck_gesture": (2, 128, 128),
    "asynet_vgg": (2, 128, 128),
    "asynet_detection": (2, 128, 192),
    "submanifold_vgg": (2, 128, 128),
    "yole": (1, 128, 128),
    "YoloTiny": (2, 128, 128),
    "YoloxNano": (2, 128, 128),
    "SsdVgg": (3, 128, 160),
    "EvFlowNet": (4, 128, 128),
    "fire_flow_net": (4, 96, 128),
    "firenet": (5, 96, 128),
    "e2vid_without_state": (5, 96, 128),
    "ev_segnet": (6, 96, 128),
    "dhp19": (1, 96, 128),
    "denoising_unet": (2, 96, 128),
    "event_depth": (5, 96, 128),
    "edncnn": (4, 25, 25),
    "SuperEvent": (1, 96, 128),
    "eye_tracker": (2, 64, 64),
    "spike_flow_decoder": (4, 96, 128),
    "GatedPyramid": (2, 64, 64),
}
"""Function or class of `event_networks.py` -> shape of its input."""

TORCHVISION = (
    "alexnet",
    "densenet121",
    "efficientnet_b0",
    "efficientnet_v2_s",
    "googlenet",
    "inception_v3",
    "mnasnet0_5",
    "mnasnet1_0",
    "mobilenet_v2",
    "mobilenet_v3_large",
    "mobilenet_v3_small",
    "regnet_x_400mf",
    "regnet_y_400mf",
    "resnet18",
    "resnet34",
    "resnet50",
    "resnext50_32x4d",
    "shufflenet_v2_x0_5",
    "shufflenet_v2_x1_0",
    "squeezenet1_0",
    "squeezenet1_1",
    "vgg11",
    "vgg16_bn",
    "wide_resnet50_2",
    "convnext_tiny",
    "vit_b_16",
    "swin_t",
    "segmentation.fcn_resnet50",
    "segmentation.deeplabv3_resnet50",
    "segmentation.lraspp_mobilenet_v3_large",
)
"""Networks of torchvision, with three input channels."""

TIMM = (
    "resnet10t",
    "resnet14t",
    "resnet18",
    "resnet18d",
    "resnet26",
    "resnet26d",
    "resnet34",
    "resnet50",
    "resnetblur50",
    "resnext26ts",
    "seresnet18",
    "seresnet50",
    "ecaresnet26t",
    "skresnet18",
    "res2net50_26w_4s",
    "cspresnet50",
    "cspdarknet53",
    "darknet53",
    "dla34",
    "dla46_c",
    "dpn48b",
    "ese_vovnet19b_dw",
    "fbnetc_100",
    "fbnetv3_b",
    "ghostnet_100",
    "hardcorenas_a",
    "hrnet_w18_small",
    "lcnet_050",
    "lcnet_100",
    "mixnet_s",
    "mobilenetv1_100",
    "mobilenetv2_050",
    "mobilenetv2_100",
    "mobilenetv3_large_100",
    "mobilenetv3_small_050",
    "mobilenetv4_conv_small",
    "mobileone_s0",
    "mnasnet_small",
    "regnetx_002",
    "regnety_002",
    "repvgg_a0",
    "rexnet_100",
    "semnasnet_075",
    "spnasnet_100",
    "tinynet_e",
    "tf_efficientnet_lite0",
    "vgg11_bn",
    "xception41",
    "efficientnet_b0",
    "convnext_atto",
    "nf_resnet26",
    "convmixer_768_32",
)
"""Networks of timm, with two input channels."""

SEGMENTATION = (
    "Unet/resnet18",
    "Unet/mobilenet_v2",
    "UnetPlusPlus/resnet18",
    "FPN/resnet18",
    "Linknet/resnet18",
    "MAnet/resnet18",
    "PSPNet/resnet18",
    "PAN/resnet18",
    "DeepLabV3/resnet18",
    "DeepLabV3Plus/resnet18",
)
"""Decoder and encoder of segmentation-models-pytorch, with two input channels and two classes."""

SIDE = 64
"""Width and height of the input of networks from libraries."""

SIDES = {"alexnet": 96, "inception_v3": 96, "vit_b_16": 224, "PAN/resnet18": 128}
"""Network of a library that needs a larger input -> its width and height."""


def entries() -> tuple[Entry, ...]:
    """The whole list."""
    found = [Entry(name, "events", name, shape) for name, shape in EVENTS.items()]
    for source, names, channels in (
        ("torchvision", TORCHVISION, 3),
        ("timm", TIMM, 2),
        ("segmentation", SEGMENTATION, 2),
    ):
        for name in names:
            side = SIDES.get(name, SIDE)
            found.append(Entry(f"{source}/{name}", source, name, (channels, side, side)))
    return tuple(found)
