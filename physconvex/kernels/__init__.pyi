from .build import (
    FLAGS as FLAGS,
    POINTER as POINTER,
    SOURCES as SOURCES,
    Kernel as Kernel,
    KernelUnavailable as KernelUnavailable,
    address as address,
    aligned as aligned,
    cache_folder as cache_folder,
    compiled as compiled,
    doubles as doubles,
)
from .cuda import launch as launch, machine_code as machine_code
