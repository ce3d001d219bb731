"""Whether an image is a PNG file as this project writes it, and nothing more.

8-bit RGB, not interlaced, of chunks IHDR, IDAT and IEND only (ISO/IEC 15948), whose deflate stream
holds the image's lines and not a byte besides: nothing can hide in it or grow when it is decoded.
"""

import struct
import zlib

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_RGB_8_BIT = (8, 2, 0, 0, 0)  # depth, colour type, compression, filter, interlace
_SIDE_MAX = 4096


def png_problem(data: bytes, size: tuple[int, int] | None = None) -> str | None:
    """What is wrong with an image file, in words that follow its name; None if nothing is.

    Parameters
    ----------
    data : bytes
    size : tuple of int, optional
        Width and height that the image must have.
    """
    if not data.startswith(_SIGNATURE):
        return "is not a PNG file"
    place = len(_SIGNATURE)
    packed: list[bytes] = []
    kinds: list[bytes] = []
    while place < len(data) and kinds[-1:] != [b"IEND"]:
        if place + 12 > len(data):
            return "is truncated"
        length, kind = struct.unpack_from(">I4s", data, place)
        end = place + 12 + length
        if end > len(data):
            return "is truncated"
        body = data[place + 8 : end - 4]
        if struct.unpack_from(">I", data, end - 4)[0] != zlib.crc32(body, zlib.crc32(kind)):
            return f"has a damaged chunk {kind!r}"
        if kind == b"IHDR" and not kinds:
            if length != 13:
                return "has a damaged header"
            width, height, *form = struct.unpack(">IIBBBBB", body)
            if tuple(form) != _RGB_8_BIT:
                return "is not 8-bit RGB"
            if (width, height) != (size or (width, height)) or max(width, height) > _SIDE_MAX:
                return f"is of {width} x {height} pixels"
        elif kind == b"IDAT":
            packed.append(body)
        elif kind != b"IEND" or length:
            return f"contains a chunk {kind!r}"
        kinds.append(kind)
        place = end
    if place != len(data):
        return f"goes on for {len(data) - place} bytes after its end"
    if kinds[:1] != [b"IHDR"] or kinds[-1:] != [b"IEND"] or not packed:
        return "is incomplete"
    count = height * (1 + 3 * width)
    stream = zlib.decompressobj()
    try:
        lines = stream.decompress(b"".join(packed), count + 1)
    except zlib.error:
        return "cannot be decoded"
    if len(lines) != count or not stream.eof or stream.unused_data:
        return "contains more or less than its lines"
    return None
