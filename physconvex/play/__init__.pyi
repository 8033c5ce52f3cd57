from .animated_glb import write_animated_glb as write_animated_glb
from .assets import Asset as Asset, RestSurface as RestSurface, read_asset as read_asset, read_surface as read_surface
from .config import (
    BasisConfig as BasisConfig,
    BodyMaterialConfig as BodyMaterialConfig,
    ContactConfig as ContactConfig,
    ConvexesConfig as ConvexesConfig,
    FloorConfig as FloorConfig,
    ForceConfig as ForceConfig,
    PlayConfig as PlayConfig,
    StartConfig as StartConfig,
    TimeConfig as TimeConfig,
    load_play_config as load_play_config,
    overrides_of as overrides_of,
)
from .fields import (
    frames_of_field as frames_of_field,
    moving_fields as moving_fields,
    moving_half_spaces as moving_half_spaces,
)
from .pictures import frames_of as frames_of
from .roll_out import PlayedObject as PlayedObject, play as play, play_together as play_together
from .simulation import configure_assets as configure_assets, simulate_assets as simulate_assets
from .writing import summary_of as summary_of, write_played as write_played
