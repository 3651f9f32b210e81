# SPDX-License-Identifier: Apache-2.0
# Sets CMAKE_CUDA_COMPILER to a system nvcc of 13 or newer, else to the one of the nvidia-cuda-nvcc package of the Python
# that builds, else leaves it unset. Sets SVGF_CUDA_ARCHITECTURES where it is empty.

if(NOT CMAKE_CUDA_COMPILER)
  find_program(system_nvcc nvcc HINTS ENV CUDACXX ENV CUDA_HOME /usr/local/cuda PATH_SUFFIXES bin)
  if(system_nvcc)
    execute_process(COMMAND ${system_nvcc} --version OUTPUT_VARIABLE version_text ERROR_QUIET)
    if(version_text MATCHES "release ([0-9]+)\\." AND CMAKE_MATCH_1 GREATER_EQUAL 13)
      set(CMAKE_CUDA_COMPILER ${system_nvcc})
    endif()
  endif()
endif()

if(NOT CMAKE_CUDA_COMPILER)
  execute_process(
    COMMAND ${Python_EXECUTABLE} -c
      "import importlib.util as u; s = u.find_spec('nvidia'); print(next(iter(s.submodule_search_locations)) if s else '')"
    OUTPUT_VARIABLE nvidia_package OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
  set(toolkit ${nvidia_package}/cu13)
  if(nvidia_package AND EXISTS ${toolkit}/bin/nvcc)
    set(CMAKE_CUDA_COMPILER ${toolkit}/bin/nvcc)
    # The wheels keep the static runtime in lib, where nvcc does not look.
    set(CMAKE_CUDA_FLAGS_INIT "-L${toolkit}/lib")
  endif()
endif()

if(CMAKE_CUDA_COMPILER AND NOT SVGF_CUDA_ARCHITECTURES)
  execute_process(COMMAND nvidia-smi --query-gpu=compute_cap --format=csv,noheader
    OUTPUT_VARIABLE capabilities RESULT_VARIABLE failed OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
  if(failed EQUAL 0 AND capabilities MATCHES "^[0-9]")
    set(SVGF_CUDA_ARCHITECTURES native)
  else()
    # Machine code and PTX of the oldest GPU that is supported: the driver compiles the PTX for newer ones.
    set(SVGF_CUDA_ARCHITECTURES 75)
  endif()
endif()
