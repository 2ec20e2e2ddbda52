"""Joints for programs that skin: influences, merged joints, and joints that turn."""
