"""Operations on arrays of views and pictures; may import compute alone; arrays leave."""
