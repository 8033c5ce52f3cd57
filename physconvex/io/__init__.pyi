from .camera import UNDISTORT_ITERATIONS as UNDISTORT_ITERATIONS, Camera as Camera, look_at as look_at
from .capture.folder import (
    Capture as Capture,
    Floor as Floor,
    load_capture as load_capture,
    read_mesh as read_mesh,
)
from .capture.metadata import (
    CAPTURE_FILE as CAPTURE_FILE,
    CaptureFile as CaptureFile,
    capture_schema as capture_schema,
    read_capture_file as read_capture_file,
)
from .capture.parts import Boundary as Boundary, Tracks as Tracks
from .capture.saving import save_capture as save_capture, write_mask as write_mask
from .configuration import (
    FrozenConfig as FrozenConfig,
    read_tree as read_tree,
    set_value as set_value,
    validated as validated,
)
from .notebook import Picture as Picture, data_uri as data_uri, html_summary as html_summary, png_bytes as png_bytes
from .opengl import load_triton_first as load_triton_first
from .options import CommandLine as CommandLine, Options as Options, command as command
from .video.images import read_image_sequence as read_image_sequence
from .video.reading import read_video as read_video
from .video.result import Video as Video, VideoCause as VideoCause, VideoError as VideoError
from .video.writing import write_video as write_video
from .whole_files import whole_file as whole_file, write_json as write_json
from .workers import (
    ONE_THREAD as ONE_THREAD,
    Workers as Workers,
    end_with_parent as end_with_parent,
    one_thread_each as one_thread_each,
)
