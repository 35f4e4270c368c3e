# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0

# rosidl exports its Python targets with the absolute include directories of Python and numpy on
# the machine that built them. CMake refuses such a directory where it does not exist (the message
# packages on PyPI) or where it lies below the source directory (an environment inside the clone).
# With a ROS 2 from a distribution nothing changes but that obc_ros exports no such directory.

function(_drop_missing_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(target MATCHES "__rosidl_generator_py$" AND directories)
      set(present "")
      foreach(directory IN LISTS directories)
        if(IS_DIRECTORY "${directory}")
          list(APPEND present "${directory}")
        endif()
      endforeach()
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${present}")
    endif()
  endforeach()
endfunction()

function(mend_python_include_directories target)
  get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
  set_target_properties(${target} PROPERTIES
    INTERFACE_INCLUDE_DIRECTORIES "$<BUILD_INTERFACE:${directories}>")
  _drop_missing_include_directories()
endfunction()
