from .build import (
    FLAGS as FLAGS,
    POINTER as POINTER,
    SOURCES as SOURCES,
    Functions as Functions,
    KernelUnavailable as KernelUnavailable,
    address as address,
    aligned as aligned,
    available as available,
    cache_folder as cache_folder,
    compiled as compiled,
    doubles as doubles,
    loaded as loaded,
)
from .cuda import launch as launch
from .principal_strains import flow_response as flow_response, singular_values as singular_values
