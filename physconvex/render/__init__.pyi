from .compiled import RENDER_FLAGS as RENDER_FLAGS, composite_kernel as composite_kernel
from .directions import slopes as slopes
from .jacobian import ImageJacobian as ImageJacobian, render_jacobian as render_jacobian
from .movies import film as film, orbit as orbit
from .projection import Splats as Splats, project_field as project_field
from .rasterize import RenderedImage as RenderedImage, render as render, splat as splat
from .reference import LEAST_ALPHA as LEAST_ALPHA, composite_reference as composite_reference
from .view import View as View
from .viewer import FieldViewer as FieldViewer
