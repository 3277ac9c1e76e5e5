# SPDX-License-Identifier: Apache-2.0
"""Conversion between the containers, byte for byte, and to the words that DMA memory needs."""

from __future__ import annotations

from cm.device.native import bitstream as native
from cm.formats.bitstream.container import BitHeader, Container, Image, Source, open_image, pack_bit
from cm.formats.bitstream.errors import BadContainer, BitstreamError


def _ordered(image: Image, swapped: bool) -> bytes:
    """Return the configuration words in this byte order; a rest of a word is an error."""
    if image.rest:
        raise BadContainer(f"{image.rest} bytes follow the last whole word: the file is damaged")
    return bytes(image.stream) if image.swapped == swapped else native.swap(image.stream)


def to_dma_words(source: Source | Image) -> bytes:
    """Return the configuration words in memory order (``66 55 99 AA``), as ICAP DMA and PCAP read them.

    The container is taken off; the words are those of the file, padding included.
    """
    image = source if isinstance(source, Image) else open_image(source)
    return _ordered(image, swapped=True)


def _recognisable(data: bytes, form: Container) -> bytes:
    """Refuse words that only a header could distinguish from another container: a `.bin` has none."""
    try:
        found = open_image(data).container
    except BitstreamError as error:
        raise BadContainer(f"the words begin as no {form.value} may: it would be refused ({error})") from error
    if found is not form:
        raise BadContainer(f"the words begin like those of a {found.value}: as a {form.value} they would be read so")
    return data


def convert(source: Source, form: Container, header: BitHeader | None = None) -> bytes:
    """Return the bitstream in another container.

    A `.bit` needs `header` where the source has none; words that could not be recognised as a `.bin` again are
    refused. Converting between `.bit`, swapped and straight `.bin` and back gives the same bytes. Boot images are
    read, not written.
    """
    image = open_image(source)
    if form is Container.BOOTGEN:
        raise BadContainer("boot images are read, not written: use bootgen with the .bit")
    if form is not Container.BIT:
        return _recognisable(_ordered(image, swapped=form is Container.BIN_SWAPPED), form)
    found = header or image.header
    if found is None:
        raise BadContainer("a .bit needs a header (design, part, date, time), and a .bin has none: give one")
    return pack_bit(found, _ordered(image, swapped=False))
