"""Operations on pixels before the comparison: layout, masks, tone curve, colours, bounds; and encodings of images."""
