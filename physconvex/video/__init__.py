"""Read and write videos; one error per way in which a file can be bad."""

from physconvex.video.errors import VideoCause, VideoError
from physconvex.video.frames import Video
from physconvex.video.images import read_image_sequence
from physconvex.video.reading import read_video
from physconvex.video.writing import write_video

__all__ = ["Video", "VideoCause", "VideoError", "read_image_sequence", "read_video", "write_video"]
